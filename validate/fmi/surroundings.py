"""The surroundings of a process: folder, environment, floating-point modes, signals, files.

    before = surroundings()
    ..
    changes(before, surroundings())     # ["the working folder is /, it was /tmp"]

Called code must leave them unchanged: its caller goes on with them.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import signal
import sys
from functools import lru_cache
from typing import Any

import numpy as np

# The smallest normal number; half of it is zero if denormal numbers are switched off.
_DENORMAL = np.float64(2.0**-1022)
_LC_ALL = 6  # of glibc
_MASKS = {0: "to nearest", 0x400: "downward", 0x800: "upward", 0xC00: "toward zero"}
# Room for struct sigaction, which begins with the handler's address.
_SIGACTION = 256
# Begin of a file's name in a sentence.
_FILE = "the file here "
# Files of the working folder that are compared.
_MOST_FILES = 1000


@lru_cache(maxsize=1)
def symbols() -> Any:
    """Return the symbols of this process; None if the system has none."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):
        return None


def surroundings() -> dict[str, Any]:
    """Return the surroundings by their names in a sentence; all of them on Linux alone."""
    found: dict[str, Any] = {"the working folder": "gone"}
    with contextlib.suppress(OSError):
        found["the working folder"] = os.getcwd()
    found["what becomes of denormal numbers"] = (
        "they stay" if float(_DENORMAL / 2.0) > 0.0 else "zero"
    )
    found |= (
        {f"the environment variable {name}": value for name, value in _environment().items()}
        | _files()
        | _descriptors()
    )
    mask = os.umask(0)
    os.umask(mask)
    found["the mask of new files"] = f"{mask:03o}"
    if hasattr(signal, "getitimer"):
        found["the alarm clock"] = (
            "set" if signal.getitimer(signal.ITIMER_REAL)[0] > 0.0 else "not set"
        )
    call = symbols()
    if call is None or sys.platform != "linux":
        return found
    with contextlib.suppress(AttributeError):
        found["rounding of numbers"] = _MASKS.get(call.fegetround(), "another mode")
        found["trapping of floating-point errors"] = "on" if call.fegetexcept() else "off"
        call.setlocale.restype = ctypes.c_char_p
        found["the locale"] = (call.setlocale(_LC_ALL, None) or b"").decode(errors="replace")
    for number in sorted(signal.valid_signals()):
        room = ctypes.create_string_buffer(_SIGACTION)
        if call.sigaction(int(number), None, room) == 0:
            found[f"the handler of {getattr(number, 'name', f'signal {number}')}"] = room.raw[:8]
    return found


# Begin of a name -> words for an item that is gone, new, or changed.
_WORDS = {
    "file descriptor": ("closed", "", "another file"),
    "the handler": ("another one", "another one", "another one"),
    _FILE: ("gone", "new or changed", "new or changed"),
    "the environment": ("gone", "new", "another one"),
}


def changes(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Return clauses about changes; new file descriptors may be open while an FMU lives."""
    found = []
    moved = before["the working folder"] != after["the working folder"]
    for name in [*before, *(name for name in after if name not in before)]:
        one, two = before.get(name), after.get(name)
        if (
            one == two
            or (moved and name.startswith(_FILE))
            or (one is None and name.startswith("file descriptor"))
        ):
            continue
        words = next((words for kind, words in _WORDS.items() if name.startswith(kind)), None)
        found.append(
            f"{name} is {words[0 if two is None else 1 if one is None else 2] if words else f'{two}, it was {one}'}"
        )
    return found


def listed(items: list[str], most: int = 3) -> str:
    """Return the first texts and the number of further ones."""
    more = len(items) - most
    return "; ".join(items[:most]) + (f"; and {more} more" if more > 0 else "")


def _files() -> dict[str, int]:
    """Return the files of the working folder, with times of change [ns]."""
    found = {}
    with contextlib.suppress(OSError), os.scandir(".") as entries:
        for entry in itertools.islice(entries, _MOST_FILES):
            if entry.is_file(follow_symlinks=False):
                found[f"{_FILE}{entry.name!r}"] = entry.stat(follow_symlinks=False).st_mtime_ns
    return found


def _environment() -> dict[str, bytes]:
    """Return the environment of C; os.environ is a copy."""
    call = symbols()
    try:
        rows = ctypes.POINTER(ctypes.c_char_p).in_dll(call, "environ")
    except (AttributeError, TypeError, ValueError):
        return {name: value.encode() for name, value in os.environ.items()}
    texts = (
        itertools.takewhile(
            lambda text: text is not None, (rows[place] for place in itertools.count())
        )
        if rows
        else ()
    )
    pairs = (text.partition(b"=") for text in texts)
    return {name.decode(errors="replace"): value for name, _, value in pairs}


def _descriptors() -> dict[str, tuple[int, int]]:
    """Return device and inode of each open file."""
    try:
        numbers = sorted(map(int, os.listdir("/proc/self/fd")))
    except OSError:
        numbers = range(64)
    found = {}
    for number in numbers:
        with contextlib.suppress(OSError):
            status = os.fstat(number)
            found[f"file descriptor {number}"] = (status.st_dev, status.st_ino)
    return found
