"""One file, one hard case: h<number>_<name>.py defines CASE."""
