"""Measure CPU seconds in children of one thread.

    found = sample("module:name", Size(3, 500), folder, seconds=600.0, what="the replay")
    found.cpu_s

`sample` runs `measure` in a child process: prepare, then the clock.
"""

from __future__ import annotations

import importlib
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any, TypeVar

from benchmarks import ROOT

_Answer = TypeVar("_Answer")
# A measured function returns this: it does the work once and returns what came of it (`outcome`,
# `iterations`, `value`, `cpu_s`; all optional).
Work = Callable[[], Mapping[str, Any]]
# Work shorter than this [CPU s] is repeated until so much has passed: the system's clock counts
# ticks.
_LEAST = 0.1
_MOST_CALLS = 100_000
_NUMBERS = ("iterations", "value", "outcome")
# Address space of a child: PyTorch maps a lot that it never uses.
_MEMORY = 64 * 1024**3


@dataclass(frozen=True, order=True)
class Size:
    """n carts in a row, T = steps."""

    n: int
    steps: int

    def __str__(self) -> str:
        return f"n = {self.n}, T = {self.steps}"


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One measurement.

    cpu_s [s]: of one call of the work, its child processes included; value: a number that all ways
    to the same answer must share; failed: why there is none.
    """

    cpu_s: float | None
    outcome: str = "ok"
    iterations: int = 0
    value: float | None = None
    failed: str = ""


def scratch(folder: str | Path) -> Path:
    """A new folder inside `folder`, for a work that must find nothing there."""
    return Path(tempfile.mkdtemp(dir=folder))


def measure(request: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, Any]:
    """CPU seconds of one call of the work."""
    module, _, name = request["function"].partition(":")
    prepare = getattr(importlib.import_module(module), name)
    work: Work = prepare(Size(request["n"], request["steps"]), Path(request["folder"]))
    began = cpu_seconds()
    told = work()
    told_s, calls = told.get("cpu_s"), 1
    if not request["once"] and cpu_seconds() - began < _LEAST:
        # The first call may have filled caches of the processor and of ours.
        told_s, calls, began = None, 0, cpu_seconds()
        while calls == 0 or (calls < _MOST_CALLS and cpu_seconds() - began < _LEAST):
            told = work()
            calls += 1
            if "cpu_s" in told:
                told_s = (told_s or 0.0) + told["cpu_s"]
    spent = cpu_seconds() - began if told_s is None else told_s
    found = {key: told[key] for key in _NUMBERS if told.get(key) is not None}
    return {"cpu_s": spent / calls, **found}


def cpu_seconds() -> float:
    """Of this process and of the children it has waited for [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def sample(
    function: str, size: Size, folder: Path, *, seconds: float, what: str, once: bool = False
) -> Sample:
    """Measure a function `module:name` in a child.

    seconds: wall time that it may take; what: its name in the sentence of a failure.
    """
    from validate.processes.isolated import Limits, run_isolated

    request = {
        "function": function,
        "n": size.n,
        "steps": size.steps,
        "once": once,
        "folder": str(folder),
    }
    limits = Limits(seconds=seconds, memory=_MEMORY)
    done = run_isolated("benchmarks.measure:measure", request, limits=limits, what=what)
    if done.ok:
        return Sample(**done.value)
    sentence = done.sentence if what in done.sentence else f"{what}: {done.sentence}"
    return Sample(cpu_s=None, failed=sentence)


def timed(work: Callable[[], _Answer]) -> tuple[_Answer, float]:
    """The answer and the CPU seconds of this process."""
    began = process_time()
    return work(), process_time() - began


def run_child(module: str, *arguments: str, cpu_limit: float) -> subprocess.CompletedProcess[str]:
    """Run `python -m module arguments` with one thread, and end it by SIGXCPU after `cpu_limit` CPU seconds."""
    environment = {
        **os.environ,
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    }
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), environment.get("PYTHONPATH", "")])
    )
    most = int(cpu_limit) + 1
    limited = f'ulimit -S -t {most}; ulimit -H -t {most + 1}; exec "$@"'
    # A session of its own, as Ctrl-C goes to all of a terminal's; no preexec_fn: what Python calls
    # before a fork may swallow a Ctrl-C.
    return subprocess.run(
        ["sh", "-c", limited, "sh", sys.executable, "-m", module, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        start_new_session=True,
    )
