"""What an instance remembers, and what it leaves behind in the process whose guest it is.

A saved state restores everything, serialised in another process too; runs repeat, reset forgets
everything, instances do not know each other, and what is freed is given back. What is looked at
while an instance lives are folder, environment, signals, descriptors and floating-point modes
(validate.fmi.surroundings); after it was freed, child processes, threads, open files and files on
the disk, of which each life of an instance must not leave more.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import gc
import itertools
import mmap
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
    in_fork,
    not_offered,
    passed,
    unless,
)
from validate.fmu_check.motion import compare, fresh_run, require_equal, restart_limit, run
from validate.fmu_check.subject import CheckedInstance, Subject

# Where in a run states are saved.
_SHARES = (0.0, 0.3, 0.7)
# The error of an integrator that starts afresh: with this tolerance it is at most this share of
# what it is with the FMU's own, and at different times it varies by such a factor.
_TIGHT = 1e-8
_SHRUNK = 0.1
_SAFETY = 4.0
# Seconds for one half of the serialisation check.
_HALF_SECONDS = 25.0
# Memory taken before the FMU is loaded a second time, so that nothing lies where it lay: an address
# in the bytes shows.
_SHIFT = 37 * 1024**2

# How FMI 2.0 and 3.0 spell it.
_SAVES = ("canGetAndSetFMUstate", "canGetAndSetFMUState")
_SERIALISES = ("canSerializeFMUstate", "canSerializeFMUState")


@check("set state restores", Scope.EACH, clauses=("2.1.8", "2.2.7.4"), needs=_SAVES)
def restores(subject: Subject, kind: str) -> Finding:
    """A saved state, set again after other steps and other inputs, continues as the first time."""
    steps = subject.steps(kind)
    length = max(2, steps // 4)
    worst, limit = 0.0, restart_limit(subject)
    places = sorted({int(share * (steps - length)) for share in _SHARES})
    for place in places:
        with CheckedInstance(subject, kind).begin_varied() as instance:
            if place:
                run(instance, 0, place)
            before = instance.observe()
            saved, next_event = instance.save(), instance.next_event
            reference = run(instance, place, place + length)
            run(
                instance, place + length, place + 2 * length, seed=1
            )  # elsewhere, with other inputs
            state = f"the state saved at t = {subject.time(place):.6g} s"
            for turn in ("", "a second time "):
                _restore(instance, saved, next_event, place)
                _, where = compare(
                    subject, before[np.newaxis], instance.observe()[np.newaxis], place
                )
                if where:
                    return failed(f"{state} was set {turn}again, but {where}.")
                share, where = compare(
                    subject, reference, run(instance, place, place + length), place
                )
                if share > limit and limit == restart_limit(subject):
                    limit = max(limit, _restart_error(subject, kind, place, length))
                if share > limit:
                    return failed(f"continued {turn}from {state}, {where}.")
                worst = max(worst, share)
            instance.forget(saved)
    how = (
        "equal bits"
        if worst == 0.0
        else f"equal to {worst:.1g} of their size (its integrator starts afresh)"
    )
    return passed(
        f"saved at {len(places)} times, set twice each, continued for {length} steps: {how}."
    )


def _restart_error(subject: Subject, kind: str, first: int, length: int) -> float:
    """How far a run that goes on from a set state may be from the first one, as a share of a variable's size, because the FMU's integrator starts afresh.

    That error shrinks with the FMU's tolerance; what was forgotten does not. 0 where a tighter
    tolerance does not help.
    """
    shares = []
    for tolerance in (None, _TIGHT) if kind == "CS" else ():
        with CheckedInstance(subject, kind, f"tolerance {tolerance}") as instance:
            instance.tolerance = tolerance
            instance.begin_varied()
            if first:
                run(instance, 0, first)
            saved = instance.save()
            reference = run(instance, first, first + length)
            instance.restore(saved)
            shares.append(compare(subject, reference, run(instance, first, first + length))[0])
    return _SAFETY * shares[0] if shares and shares[1] <= _SHRUNK * shares[0] else 0.0


def _restore(instance: CheckedInstance, saved: Any, next_event: float, step: int) -> None:
    """Set a saved state.

    To Model Exchange the time of its step and its next event are given again: both are from
    outside, and need not be part of it.
    """
    instance.restore(saved)
    if instance.kind == "ME":
        instance.set_time(instance.subject.time(step))
    instance.next_event = next_event


@check(
    "serialised state loads elsewhere", Scope.EACH, clauses=("2.1.8", "2.2.7.4"), needs=_SERIALISES
)
def serialises(subject: Subject, kind: str) -> Finding:
    """The bytes of a state, loaded in a new process, continue as the first process did."""
    steps = subject.steps(kind)
    place, length = steps // 2, max(2, steps // 4)

    def first() -> dict[str, Any]:
        with CheckedInstance(subject, kind).begin_varied() as instance:
            run(instance, 0, place)
            saved, next_event = instance.save(), instance.next_event
            data = instance.fmu.serializeFMUState(saved)
            again = instance.fmu.serializeFMUState(saved)
            rows = run(instance, place, place + length)
        return {
            "data": data.hex(),
            "same": data == again,
            "rows": rows.tolist(),
            "next": next_event,
        }

    def second(data: bytes, next_event: float) -> list[list[float]]:
        junk = mmap.mmap(-1, _SHIFT)
        others = [CheckedInstance(subject, kind, f"other {number}") for number in range(3)]
        with CheckedInstance(subject, kind).begin() as instance:
            _restore(instance, instance.fmu.deserializeFMUState(data), next_event, place)
            rows = run(instance, place, place + length).tolist()
        for other in others:
            other.free()
        junk.close()
        return rows

    where = "while a state was serialised"
    try:
        found = in_fork(first, _HALF_SECONDS)
        where = "in a new process"
        read = in_fork(lambda: second(bytes.fromhex(found["data"]), found["next"]), _HALF_SECONDS)
    except Misbehaviour as fault:
        return failed(f"{where}: {fault}.")
    share, where = compare(subject, np.array(found["rows"]), np.array(read), place)
    if share > restart_limit(subject) and share > _restart_error(subject, kind, place, length):
        return failed(f"continued in a new process from the serialised state, {where}.")
    if not found["same"]:
        return failed("one state serialised twice gives different bytes.")
    how = (
        f"equal to {share:.1g} of their size (its integrator starts afresh)"
        if where
        else "equal bits"
    )
    return passed(
        f"{len(found['data']) // 2} bytes saved at t = {subject.time(place):.6g} s, continued for {length} steps: {how}."
    )


# Steps of instances that are stepped in turn.
_IN_TURN = 20
# Runs before memory is measured, batches that are measured, runs in each (at most), seconds for
# all.
_WARM = 25
_BATCHES = 6
_RUNS = 40
_LEAK_SECONDS = 3.0
# Bytes a run may keep: the least that malloc gives is 32, what is less on average is its noise.
_KEPT = 24.0
# Of few runs, so much a batch is Python's own [bytes].
_BATCH_KEPT = 512.0
_RESIDENT_KEPT = 1024.0


@check("runs repeat", Scope.EACH)
def repeats(subject: Subject, kind: str) -> Finding:
    """Two fresh instances with the same inputs give the same bits."""
    steps = subject.steps(kind)
    first, second = (fresh_run(subject, kind, steps, name) for name in ("first", "second"))
    require_equal(subject, first, second, "in a second run")
    return passed(f"{first.shape[1]} values over {len(first) - 1} steps: equal bits.")


@check("reset equals a fresh instance", Scope.EACH, clauses=("2.1.6", "2.3.1"))
def resets(subject: Subject, kind: str) -> Finding:
    """After a run with other parameters and inputs, reset forgets all of it."""
    steps = subject.steps(kind)
    reference = fresh_run(subject, kind, steps, "fresh")
    with CheckedInstance(subject, kind, "reset") as instance:
        for terminated in (True, False):
            instance.begin_varied()
            run(instance, 0, steps // 2, seed=1, observe="end")
            if terminated:
                instance.fmu.terminate()
            instance.fmu.reset()
            clause = f"after reset{' from a terminated run' if terminated else ''}"
            require_equal(subject, reference, run(instance.begin(), 0, steps), clause)
            instance.fmu.reset()
    return passed(
        f"reset after and without terminate, then {len(reference) - 1} steps each: equal bits."
    )


@check("instances do not disturb each other", Scope.EACH, clauses=("2.1.5", "2.3.1"))
def independent(subject: Subject, kind: str) -> Finding:
    """Two instances stepped in turn give what each gives alone, and keep it while the other steps."""
    if subject.can(kind, "canBeInstantiatedOnlyOncePerProcess"):
        return not_offered("canBeInstantiatedOnlyOncePerProcess is true.")
    steps = min(subject.steps(kind), _IN_TURN)

    def in_turn(name: str, *seeds: int) -> Iterator[np.ndarray]:
        """(steps + 1, observed) [unit of each variable] before and after each step, of an instance for each seed: two know other parameters and inputs.

        Each is read again when another has stepped. Raises as `run`; Failed where that gives
        something else.
        """
        instances = {seed: CheckedInstance(subject, kind, f"{name} {seed}") for seed in seeds}
        for seed, instance in instances.items():
            instance.begin_varied() if seed else instance.begin()
        rows = {seed: [instance.observe()] for seed, instance in instances.items()}
        for step, (seed, instance) in itertools.product(range(steps), instances.items()):
            rows[seed].append(run(instance, step, step + 1, seed=seed, observe="end")[0])
            for other in instances.keys() - {seed}:
                last, again = np.array(rows[other][-1:]), instances[other].observe()[np.newaxis]
                require_equal(
                    subject, last, again, "after a step of another instance", len(rows[other]) - 1
                )
        for instance in instances.values():
            instance.close()
        yield from map(np.array, rows.values())

    alone = [*in_turn("alone", 0), *in_turn("alone", 1)]
    for one, beside in zip(alone, in_turn("pair", 0, 1), strict=True):
        require_equal(subject, one, beside, "beside another instance")
    return passed(
        f"{steps} steps each in turn, with different parameters and inputs, each read again after the other's step: equal bits."
    )


@check("freed instances give memory back", Scope.EACH, clauses=("2.1.5", "2.3.1"))
def leaks(subject: Subject, kind: str) -> Finding:
    """Instantiating, running, saving states and freeing again and again does not grow the process."""
    instance = CheckedInstance(subject, kind)
    saves = subject.can(kind, _SAVES[subject.major >= 3])

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
    runs = int(
        np.clip(_LEAK_SECONDS / _BATCHES / ((time.perf_counter() - began) / 5 + 1e-6), 3, _RUNS)
    )
    for _ in range(_WARM):
        once()
    marks = [_memory()]
    for _ in range(_BATCHES):
        for _ in range(runs):
            once()
        marks.append(_memory())
    grown = np.diff(np.array(marks), axis=0) / runs
    for column, (what, kept) in enumerate(
        (("allocated", max(_KEPT, _BATCH_KEPT / runs)), ("resident", _RESIDENT_KEPT))
    ):
        # A leak grows in every batch; what settles, or jumps once, is no leak.
        if np.min(grown[:, column]) > 0.0 and np.median(grown[:, column]) >= kept:
            return failed(
                f"each run keeps {np.median(grown[:, column]):.0f} bytes of {what} memory ({runs * _BATCHES} runs)."
            )
    return passed(
        f"{runs * _BATCHES} runs: {max(0.0, np.median(grown[:, 0])):.0f} bytes kept by each."
    )


class _MallocInfo(ctypes.Structure):
    """struct mallinfo2 of the GNU C library: hblkhd, the bytes in large blocks, is its fifth number, uordblks, those in others, its eighth."""

    _fields_ = [("numbers", ctypes.c_size_t * 10)]


def _memory() -> tuple[float, float]:
    """(bytes allocated on the heap, bytes resident), Python's own garbage collected.

    0 where the system does not tell.
    """
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


# Communication steps, or evaluations, of one life of an instance; and how long what it started may
# take to end [s].
_LIFE = 20
_GRACE = 0.2
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
    steps = subject.before_end(kind, _LIFE)
    files = _files(subject)
    with _printed() as said:
        _live(subject, kind, steps, wrong)  # what it opens and starts once it may keep
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
    if said:
        wrong.append(f"it prints on the standard output: {''.join(said)[:_QUOTED]!r}")
    fine = f"two lives of {steps} {'steps' if kind == 'CS' else 'evaluations'}: nothing is changed, printed or left."
    return unless(list(dict.fromkeys(wrong)), fine)


def _live(subject: Subject, kind: str, steps: int, wrong: list[str]) -> None:
    """One life of an instance; what it changes of the process meanwhile is added to `wrong`."""
    before = surroundings()
    instance = CheckedInstance(subject, kind).begin()
    instance.live(steps)
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
    """Child processes; those that have ended are not counted, unless nobody can wait for them."""
    found: set[int] = set()
    for thread in _threads():
        with (
            contextlib.suppress(OSError),
            open(f"/proc/self/task/{thread}/children", encoding="ascii") as file,
        ):
            found.update(map(int, file.read().split()))
    return found


def _lasting(look: Callable[[], set[Any]]) -> set[Any]:
    """What is there, after it had time to end."""
    until = time.monotonic() + _GRACE
    while (found := look()) and time.monotonic() <= until:
        time.sleep(_GRACE / 20)
    return found


def _files(subject: Subject) -> set[tuple[str, int]]:
    """Files of the FMU's own folder, and when each was changed [ns]."""
    paths = [Path(folder, name) for folder, _, names in os.walk(subject.folder) for name in names]
    return {(str(path.relative_to(subject.folder)), path.stat().st_mtime_ns) for path in paths}


def _count(items: set[Any], what: str) -> str:
    number = len(items)
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
    return (
        failed(f"{said}.")
        if subject.major >= 3
        else advice(f"{said}: a description of another version would go unnoticed.")
    )
