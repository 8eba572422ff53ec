"""Anybody's FMU: let in (archive), described (description), loaded and called (instance, over FMPy's classes), and run by loops in C (loops)."""
