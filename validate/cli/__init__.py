"""One file = one command of `python -m validate`."""
