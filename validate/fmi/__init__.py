"""Anybody's FMU: let in, described, loaded and called."""
