"""Stored results of finished tasks, and their keys."""
