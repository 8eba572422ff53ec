"""What every benchmark measures with: CPU seconds, memory, and children that are measured by themselves.

    found = sample("module:name", Size(3, 500), folder, seconds=600.0, what="the replay")
        found.cpu_s, found.memory_mib
    answer, seconds = least(lambda: solve(problem), repetitions=3)

`sample` runs `measure` in a child process of one thread: prepare, then the clock.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
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
# What a measured function hands back: does the work once, and says what came of it (`outcome`,
# `iterations`, `value`, `cpu_s`; all optional).
Work = Callable[[], Mapping[str, Any]]
# Work shorter than this [CPU s] is called again until so much has passed: the clock of the system
# counts ticks.
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
        return f"n = {self.n}, T = {self.steps}" if self.n else ""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One measurement. cpu_s [s]: of one call of the work, its child processes included.

    memory_mib: what the work added to the resident

    set at its largest; value: a number by which it can be seen that all ways end at the same
    answer; failed: why there is none.
    """

    cpu_s: float | None
    memory_mib: float | None = None
    outcome: str = "ok"
    iterations: int = 0
    value: float | None = None
    failed: str = ""


def scratch(folder: str | Path) -> Path:
    """A new folder inside `folder`, for a work that must find nothing there."""
    return Path(tempfile.mkdtemp(dir=folder))


def measure(request: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, Any]:
    """CPU seconds of one call of the work, and what it added to the resident set of this process at its largest [MiB]."""
    module, _, name = request["function"].partition(":")
    prepare = getattr(importlib.import_module(module), name)
    work: Work = prepare(Size(request["n"], request["steps"]), Path(request["folder"]))
    before, began = _begin_memory(), cpu_seconds()
    told = work()
    told_s, calls, memory = told.get("cpu_s"), 1, max(0.0, _peak() - before)
    if not request["once"] and cpu_seconds() - began < _LEAST:
        told_s, calls, began = (
            None,
            0,
            cpu_seconds(),
        )  # the first call may have filled caches of the processor and of ours
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

    What preparing has freed goes back to the system first, where the C library can: work that fits
    into it would seem to need nothing, and memory to grow faster with T than it does.
    """
    gc.collect()
    with contextlib.suppress(
        OSError, AttributeError, TypeError
    ):  # Linux with glibc only; TypeError: no library without a name on Windows
        ctypes.CDLL(None).malloc_trim(0)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _peak()


def _peak() -> float:
    """The largest resident set [MiB].

    Not `ru_maxrss` where there is another way: a child begins with its parent's.
    """
    with contextlib.suppress(OSError):
        for line in (
            Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
        ):
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1024.0**2 if sys.platform == "darwin" else 1024.0
    )


def sample(
    function: str, size: Size, folder: Path, *, seconds: float, what: str, once: bool = False
) -> Sample:
    """Measure a function `module:name` in a child; seconds: wall time that it may take.

    what: how it is called if it fails.
    """
    from validate.execution.isolated import Limits, run_isolated

    request = {
        "function": function,
        "n": size.n,
        "steps": size.steps,
        "once": once,
        "folder": str(folder),
    }
    done = run_isolated(
        "benchmarks.measure:measure",
        request,
        limits=Limits(seconds=seconds, memory=_MEMORY),
        what=what,
    )
    if not done.ok:
        return Sample(
            cpu_s=None,
            failed=done.sentence if what in done.sentence else f"{what}: {done.sentence}",
        )
    return Sample(**done.value)


def least(
    work: Callable[[], _Answer], repetitions: int = 1, enough: float = float("inf")
) -> tuple[_Answer, float]:
    """The first answer and the least CPU seconds of some repetitions, no more of them than `enough` CPU seconds allow."""
    answer, best = timed(work)
    spent = best
    for _ in range(repetitions - 1):
        if spent > enough:
            break
        again = timed(work)[1]
        best, spent = min(best, again), spent + again
    return answer, best


def timed(work: Callable[[], _Answer]) -> tuple[_Answer, float]:
    """The answer and the CPU seconds of this process."""
    began = process_time()
    return work(), process_time() - began


def run_child(
    module: str, *arguments: str, cpu_limit: float | None = None, timeout: float | None = None
) -> subprocess.CompletedProcess[str]:
    """`python -m module arguments` with one thread, wherever this process stands.

    It is gone when this returns, and Ctrl-C is ours to tell.

    cpu_limit: CPU seconds after which it is ended by SIGXCPU; timeout: wall seconds. Raises
        subprocess.TimeoutExpired.
    """
    environment = {
        **os.environ,
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    }
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), environment.get("PYTHONPATH", "")])
    )

    command = [sys.executable, "-m", module, *arguments]
    if cpu_limit is not None:
        most = int(cpu_limit) + 1
        command = [
            "sh",
            "-c",
            f'ulimit -S -t {most}; ulimit -H -t {most + 1}; exec "$@"',
            "sh",
            *command,
        ]
    # A session of its own, as Ctrl-C goes to all of a terminal's; no preexec_fn: what Python calls
    # before a fork may swallow a Ctrl-C.
    return subprocess.run(
        command,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=timeout,
        check=False,
        start_new_session=True,
    )
