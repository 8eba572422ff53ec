"""One measurement, in the child process: prepare, then the clock.

measure({"function": "module:name", "n": 3, "steps": 500, "once": false, "folder": ...}, {}) -> {"cpu_s": .., "memory_mib": .., ..}
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validate.bench.case import Size, Work

# Work shorter than this [CPU s] is called again until so much has passed: the clock of the system counts ticks.
_LEAST = 0.1
_MOST_CALLS = 100_000
_NUMBERS = ("iterations", "value", "outcome")


def measure(request: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, Any]:
    """CPU seconds of one call of the work, and what it added to the resident set of this process at its largest [MiB]."""
    module, _, name = request["function"].partition(":")
    prepare = getattr(importlib.import_module(module), name)
    work: Work = prepare(Size(request["n"], request["steps"]), Path(request["folder"]))
    before, began = _begin_memory(), cpu_seconds()
    told = work()
    told_s, calls, memory = told.get("cpu_s"), 1, max(0.0, _peak() - before)
    if not request["once"] and cpu_seconds() - began < _LEAST:
        told_s, calls, began = None, 0, cpu_seconds()  # the first call may have filled caches of the processor and of ours
        while calls == 0 or (calls < _MOST_CALLS and cpu_seconds() - began < _LEAST):
            told = work()
            calls += 1
            if "cpu_s" in told:
                told_s = (told_s or 0.0) + told["cpu_s"]
    spent = cpu_seconds() - began if told_s is None else told_s
    found = {key: told[key] for key in _NUMBERS if told.get(key) is not None}
    return {"cpu_s": spent / calls, "memory_mib": memory, **found}


def cpu_seconds() -> float:
    """Of this process and of the children it has waited for [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _begin_memory() -> float:
    """Where the work's memory counts from [MiB]: Linux forgets the peak so far, elsewhere it is that peak.

    What preparing has freed goes back to the system first, where the C library can: work that fits into it would seem to need nothing,
    and memory to grow faster with T than it does.
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):  # Linux with glibc only; TypeError: no library without a name on Windows
        ctypes.CDLL(None).malloc_trim(0)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _peak()


def _peak() -> float:
    """The largest resident set [MiB]. Not `ru_maxrss` where there is another way: a child begins with its parent's."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)
