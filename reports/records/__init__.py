"""Versioned schemas of stored records, and reading a folder of them."""
