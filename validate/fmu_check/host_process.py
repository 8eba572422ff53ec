"""An FMU is a guest in somebody's process: what it must leave there as it was, and what it must not leave behind.

What is looked at while an instance lives are folder, environment, signals, descriptors and floating-point modes (validate.fmi.surroundings); after it was freed,
child processes, threads, open files and files on the disk, of which each life of an instance must not leave more.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from validate.fmi.instance import Fault
from validate.fmi.surroundings import changes, listed, surroundings
from validate.fmu_check.check import Finding, Scope, advice, check, failed, not_offered, passed
from validate.fmu_check.subject import CheckedInstance, Subject

# Communication steps, or evaluations, of one life of an instance; and how long what it started may take to end [s].
_STEPS, _GRACE = 20, 0.2
# Of prctl: what a process leaves behind becomes a child of ours.
_CHILD_SUBREAPER = 36
# How much of what was printed is quoted.
_QUOTED = 60


@check("leaves its host as it was", Scope.EACH)
def surrounded(subject: Subject, kind: str) -> Finding:
    """It changes nothing of the process it runs in, prints nothing on its output, and leaves no process, thread, open file or file behind."""
    if sys.platform != "linux":
        return not_offered("only Linux tells that.")
    ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)
    wrong: list[str] = []
    steps = subject.before_end(kind, _STEPS)
    files = _files(subject)
    with _printed() as said:
        _live(subject, kind, steps, wrong)  # what it opens and starts once it may keep
        before, threads = surroundings(), _threads()
        _live(subject, kind, steps, wrong)
        after = surroundings()
        wrong += [f"after an instance was freed {text}" for text in changes(before, after) if text not in " ".join(wrong)]
        opened = {name for name in after if name.startswith("file descriptor")} - set(before)
        if opened:
            wrong.append(f"an instance leaves {_count(opened, 'file')} open")
        if more := _lasting(threads):
            wrong.append(f"an instance leaves {_count(more, 'thread')} behind")
        if children := _children():
            wrong.append(f"it leaves {_count(children, 'process')} behind")
        if new := sorted({name for name, _ in _files(subject) - files}):
            wrong.append(f"it changes its own files: {listed(new)}")
    if said:
        wrong.append(f"it prints on the standard output: {''.join(said)[:_QUOTED]!r}")
    if wrong:
        return failed(f"{listed(list(dict.fromkeys(wrong)))}.")
    return passed(f"two lives of {steps} {'steps' if kind == 'CS' else 'evaluations'}: nothing is changed, printed or left.")


def _live(subject: Subject, kind: str, steps: int, wrong: list[str]) -> None:
    """One life of an instance; what it changes of the process meanwhile is added to `wrong`."""
    before = surroundings()
    instance = CheckedInstance(subject, kind)
    instance.begin()
    for step in range(steps):
        if kind == "CS":
            instance.do_step(subject.time(step), subject.step)
        elif instance.state_count:
            instance.move(subject.time(step), instance.states())
            instance.rates()
    instance.observe()
    wrong += changes(before, surroundings())
    instance.close()


@contextlib.contextmanager
def _printed() -> Iterator[list[str]]:
    """What is printed on the standard output meanwhile, also by C, is in the list afterwards."""
    said: list[str] = []
    sys.stdout.flush()
    with contextlib.suppress(OSError), tempfile.TemporaryFile() as file:
        kept = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            yield said
        finally:
            ctypes.CDLL(None).fflush(None)
            with contextlib.suppress(OSError):  # it may have closed them, which is told
                os.dup2(kept, 1)
                os.close(kept)
                file.seek(0)
                said += filter(None, [file.read(10 * _QUOTED).decode(errors="replace")])


def _threads() -> set[str]:
    return set(os.listdir("/proc/self/task"))


def _children() -> set[int]:
    """Child processes, after they had time to end; those that have ended are not counted, unless nobody can wait for them."""
    until = time.monotonic() + _GRACE
    while True:
        found: set[int] = set()
        for thread in _threads():
            with contextlib.suppress(OSError), open(f"/proc/self/task/{thread}/children", encoding="ascii") as file:
                found.update(map(int, file.read().split()))
        if not found or time.monotonic() > until:
            return found
        time.sleep(_GRACE / 20)


def _lasting(before: set[str]) -> set[str]:
    """Threads that were not there before, and do not end soon."""
    until = time.monotonic() + _GRACE
    while more := _threads() - before:
        if time.monotonic() > until:
            break
        time.sleep(_GRACE / 20)
    return more


def _files(subject: Subject) -> set[tuple[str, int]]:
    """Files of the FMU's own folder, and when each was changed [ns]."""
    paths = [Path(folder, name) for folder, _, names in os.walk(subject.folder) for name in names]
    return {(str(path.relative_to(subject.folder)), path.stat().st_mtime_ns) for path in paths}


def _count(items: object, what: str) -> str:
    number = len(items)  # type: ignore[arg-type]
    return f"{number} {what}{'' if number == 1 else 'es' if what.endswith('s') else 's'}"


@check("another FMU's token is refused", Scope.EACH, clauses=("", "2.3.1"))
def token(subject: Subject, kind: str) -> Finding:
    """A description that is not the binary's own is noticed: with another token, or GUID, there is no instance."""
    description = copy.copy(subject.description)
    description.guid = f"{subject.description.guid[:-1]}-not-mine"
    other = replace(subject, description=description)
    try:
        CheckedInstance(other, kind).free()
    except Fault:
        return passed("it gives no instance for another one.")
    said = f"it gives an instance for the {'token' if subject.major >= 3 else 'GUID'} {description.guid!r}, which is not its own"
    return failed(f"{said}.") if subject.major >= 3 else advice(f"{said}: a description of another version would go unnoticed.")
