"""One file, one stress case: h<number>_<name>.py defines CASE."""
