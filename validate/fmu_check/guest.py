"""An instance as a guest in its process: memory, folder, signals, files, and description.

While an instance lives, folder, environment, signals, descriptors and floating-point modes must
stay (validate.fmi.surroundings). Each life must leave no more processes, threads, open files and
memory.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import gc
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from validate.fmi.instance import Fault, Misbehaviour
from validate.fmi.surroundings import changes, listed, surroundings, symbols
from validate.fmu_check.check import (
    Finding,
    Scope,
    advice,
    check,
    failed,
    not_offered,
    passed,
    unless,
)
from validate.fmu_check.states import SAVES
from validate.fmu_check.subject import CheckedInstance, Subject

# Runs before memory is measured: caches fill.
_WARM = 25
# Batches of runs; a leak grows in each of them.
_BATCHES = 6
# Runs of each batch, at most.
_RUNS = 40
# Time for all batches [s].
_LEAK_SECONDS = 3.0
# Bytes a run may keep: the smallest block of malloc is 32, so less on average is its noise.
_KEPT = 24.0
# Bytes a batch may keep: Python's own.
_BATCH_KEPT = 512.0
# Resident bytes a run may keep: pages of 4096 are shared by several runs.
_RESIDENT_KEPT = 1024.0


@check("freed instances give memory back", Scope.EACH, clauses=("2.1.5", "2.3.1"))
def leaks(subject: Subject, kind: str) -> Finding:
    """Instantiating, running, saving states and freeing again and again does not grow the process."""
    instance = CheckedInstance(subject, kind)
    saves = subject.can(kind, SAVES[subject.major >= 3])
    made = 1

    def once() -> None:
        nonlocal made
        if not instance.fmu.component:
            try:
                instance.instantiate()
            except Misbehaviour as error:
                raise Misbehaviour(f"{error}, after {made} others were freed") from error
        instance.begin().live(subject.before_end(kind, 3), completed=True)
        if saves:
            saved = instance.save()
            instance.restore(saved)
            instance.forget(saved)
        instance.observe()
        instance.fmu.terminate()
        instance.free()
        made += 1

    began = time.perf_counter()
    for _ in range(5):
        once()
    pace = (time.perf_counter() - began) / 5 + 1e-6
    runs = int(np.clip(_LEAK_SECONDS / _BATCHES / pace, 3, _RUNS))
    for _ in range(_WARM):
        once()
    marks = [_memory()]
    for _ in range(_BATCHES):
        for _ in range(runs):
            once()
        marks.append(_memory())
    grown = np.diff(np.array(marks), axis=0) / runs
    least, (allocated, resident) = grown.min(axis=0), np.median(grown, axis=0)
    every = f"({runs * _BATCHES} runs)"
    if least[0] > 0.0 and allocated >= max(_KEPT, _BATCH_KEPT / runs):
        return failed(f"each run keeps {allocated:.0f} bytes of allocated memory {every}.")
    if least[1] > 0.0 and resident >= _RESIDENT_KEPT:
        return failed(f"each run keeps {resident:.0f} bytes of resident memory {every}.")
    return passed(f"{runs * _BATCHES} runs: {max(0.0, allocated):.0f} bytes kept by each.")


class _MallocInfo(ctypes.Structure):
    """struct mallinfo2 of the GNU C library.

    hblkhd, bytes in large blocks, is its fifth number; uordblks, bytes in small ones, its eighth.
    """

    _fields_ = [("numbers", ctypes.c_size_t * 10)]


def _memory() -> tuple[float, float]:
    """Return the bytes allocated on the heap and the resident bytes; 0 if the system hides them."""
    gc.collect()
    allocated = resident = 0.0
    if mallinfo2 := getattr(symbols(), "mallinfo2", None):  # of the GNU C library alone
        mallinfo2.restype = _MallocInfo
        numbers = mallinfo2().numbers
        allocated = float(numbers[4] + numbers[7])
    if os.path.exists("/proc/self/statm"):
        with open("/proc/self/statm", encoding="ascii") as file:
            resident = float(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return allocated, resident


# Communication steps, or evaluations, of one life of an instance.
_LIFE = 20
# Time for threads and processes of an FMU to end [s].
_GRACE = 0.2
# Argument of prctl: orphans of our children become our children.
_CHILD_SUBREAPER = 36
# Characters of printed text that are quoted.
_QUOTED = 60


@check("leaves its host as it was", Scope.EACH)
def surrounded(subject: Subject, kind: str) -> Finding:
    """It changes nothing of the process it runs in, prints nothing on its output, and leaves no process, thread, open file or file behind."""
    if sys.platform != "linux":
        return not_offered("only Linux tells that.")
    ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)
    wrong: list[str] = []
    steps = subject.before_end(kind, _LIFE)
    files = _files(subject)
    with _printed() as printed:
        _live(subject, kind, steps, wrong)  # what the first life opens and starts may stay
        before, threads = surroundings(), _threads()
        _live(subject, kind, steps, wrong)
        after = surroundings()
        wrong += [
            f"after an instance was freed {text}"
            for text in changes(before, after)
            if text not in " ".join(wrong)
        ]
        if opened := {name for name in after if name.startswith("file descriptor")} - set(before):
            wrong.append(f"an instance leaves {_count(opened, 'file')} open")
        if more := _lasting(lambda: _threads() - threads):
            wrong.append(f"an instance leaves {_count(more, 'thread')} behind")
        if children := _lasting(_children):
            wrong.append(f"it leaves {_count(children, 'process')} behind")
        if new := sorted({name for name, _ in _files(subject) - files}):
            wrong.append(f"it changes its own files: {listed(new)}")
    if printed:
        wrong.append(f"it prints on the standard output: {''.join(printed)[:_QUOTED]!r}")
    lives = f"two lives of {steps} {'steps' if kind == 'CS' else 'evaluations'}"
    return unless(list(dict.fromkeys(wrong)), f"{lives}: nothing is changed, printed or left.")


def _live(subject: Subject, kind: str, steps: int, wrong: list[str]) -> None:
    """Run one life of an instance; add to `wrong` what it changes of the process meanwhile."""
    before = surroundings()
    instance = CheckedInstance(subject, kind).begin()
    instance.live(steps)
    instance.observe()
    wrong += changes(before, surroundings())
    instance.close()


@contextlib.contextmanager
def _printed() -> Iterator[list[str]]:
    """Collect the text that is printed on the standard output, also by C, in a list."""
    printed: list[str] = []
    sys.stdout.flush()
    with contextlib.suppress(OSError), tempfile.TemporaryFile() as file:
        kept = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            yield printed
        finally:
            ctypes.CDLL(None).fflush(None)
            with contextlib.suppress(OSError):  # a closed descriptor is reported elsewhere
                os.dup2(kept, 1)
                os.close(kept)
                file.seek(0)
                printed += filter(None, [file.read(10 * _QUOTED).decode(errors="replace")])


def _threads() -> set[str]:
    return set(os.listdir("/proc/self/task"))


def _children() -> set[int]:
    """Return the child processes of all threads."""
    found: set[int] = set()
    for thread in _threads():
        path = Path(f"/proc/self/task/{thread}/children")
        with contextlib.suppress(OSError):
            found.update(map(int, path.read_text(encoding="ascii").split()))
    return found


def _lasting(look: Callable[[], set[Any]]) -> set[Any]:
    """Return the items that are still there after _GRACE."""
    until = time.monotonic() + _GRACE
    while (found := look()) and time.monotonic() <= until:
        time.sleep(_GRACE / 20)
    return found


def _files(subject: Subject) -> set[tuple[str, int]]:
    """Return the files of the FMU's own folder, with times of change [ns]."""
    paths = (path for path in subject.folder.rglob("*") if not path.is_dir())
    return {(str(path.relative_to(subject.folder)), path.stat().st_mtime_ns) for path in paths}


def _count(items: set[Any], what: str) -> str:
    number = len(items)
    return f"{number} {what}{'' if number == 1 else 'es' if what.endswith('s') else 's'}"


@check("another FMU's token is refused", Scope.EACH, clauses=("", "2.3.1"))
def token(subject: Subject, kind: str) -> Finding:
    """There is no instance for another token, or GUID: a description that is not the binary's own is noticed."""
    description = copy.copy(subject.description)
    description.guid = f"{subject.description.guid[:-1]}-not-mine"
    try:
        CheckedInstance(replace(subject, description=description), kind).free()
    except Fault:
        return passed("it gives no instance for another one.")
    word = "token" if subject.major >= 3 else "GUID"
    wrong = f"it gives an instance for the {word} {description.guid!r}, which is not its own"
    if subject.major >= 3:
        return failed(f"{wrong}.")
    return advice(f"{wrong}: a description of another version would go unnoticed.")
