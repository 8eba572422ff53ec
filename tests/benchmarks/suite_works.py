"""Works for the tests of the suite: in the child, by their names."""

import ctypes
import os
from pathlib import Path

from benchmarks.measure import Size, Work
from models.errors import TouchstoneError


def _log(name: str) -> None:
    with open(os.environ["BENCH_LOG"], "a", encoding="utf-8") as log:
        log.write(f"{name}\n")


def steady(size: Size, folder: Path) -> Work:
    """Some milliseconds."""
    _log("steady")
    return lambda: {"value": float(sum(range(200_000)))}


def other(size: Size, folder: Path) -> Work:
    _log("other")
    return lambda: {"cpu_s": 7.0, "outcome": "solved", "iterations": 3}


def broken(size: Size, folder: Path) -> Work:
    raise TouchstoneError("it cannot.")


def dies(size: Size, folder: Path) -> Work:
    return lambda: {"value": float(ctypes.string_at(0)[0])}
