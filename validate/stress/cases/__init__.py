"""One stress case per file, h<number>_<name>.py, which defines CASE."""
