"""Supervised child processes, and foreign code in isolation."""
