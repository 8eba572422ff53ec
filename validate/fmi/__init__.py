"""Anybody's FMU: let in (archive), described (description), loaded and called (instance, over FMPy's classes), integrated (cvode), and run by loops in C (loops)."""
