"""Methods: one file each, named like its method; the file defines `METHOD`."""
