"""Sections of the page of the benchmarks: build(records) -> Section, or None where there is nothing to tell."""
