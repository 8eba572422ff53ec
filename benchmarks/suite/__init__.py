"""Each stage measured beside what people would use instead: `python -m benchmarks suite`.

    outcome = run_suite(Settings(sizes=(Size(3, 500),), repeats=5))      # benchmarks.suite.run
    outcome.record  # benchmarks.records.SuiteRecord

`cases` lists what is measured; `stages` holds our stages, `peers/` other people's ways to the same
answer, one file each. Every measurement is a child process of its own with one thread; repeats of
all of them take turns, so that a machine that slows down slows down all.
"""
