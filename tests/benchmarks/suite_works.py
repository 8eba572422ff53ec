"""Works for the tests of the suite: in the child, by their names."""

import ctypes
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.measure import Size, Work
from models.errors import TouchstoneError


def _log(name: str) -> None:
    with open(os.environ["BENCH_LOG"], "a", encoding="utf-8") as log:
        log.write(f"{name}\n")


def steady(size: Size, folder: Path) -> Work:
    """Some milliseconds."""
    _log("steady")
    return lambda: {"value": float(sum(range(200_000)))}


def heavy(size: Size, folder: Path) -> Work:
    _log("heavy")
    kept = []

    def work() -> Mapping[str, Any]:
        if not kept:
            kept.append(bytearray(os.urandom(1024)) * (64 * 1024))
        return {}

    return work


def freed_before(size: Size, folder: Path) -> Work:
    """Preparing needs 40 MiB in pieces and frees all but the last, below which they lie.

    The work needs the same again.
    """
    pieces = _pieces()
    pinned = [pieces[-1]]
    del pieces
    return lambda _pinned=pinned: {"value": float(len(_pieces()))}


def _pieces() -> list[bytes]:
    return [
        bytes([place % 255 + 1]) * 102_400 for place in range(400)
    ]  # each below what malloc asks the system for anew


def broken(size: Size, folder: Path) -> Work:
    raise TouchstoneError("it cannot.")


def dies(size: Size, folder: Path) -> Work:
    return lambda: {"value": float(ctypes.string_at(0)[0])}
