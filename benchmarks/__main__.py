"""`python -m benchmarks`."""

from validate.__main__ import main

if __name__ == "__main__":
    main("benchmarks.commands")
