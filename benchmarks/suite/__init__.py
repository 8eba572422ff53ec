"""Each stage measured beside what people would use instead: `python -m benchmarks suite`.

`cases` lists what is measured; `stages` holds our stages, `peers/` other people's ways to the same
answer, one file each. Every measurement is a child process with one thread. All take turns, round
after round, so that a machine that slows down slows down all.
"""
