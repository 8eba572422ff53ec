"""Instances: runs repeat, reset forgets everything, instances do not know each other, and what is freed is given back."""

from __future__ import annotations

import ctypes
import gc
import itertools
import os
import time
from functools import lru_cache
from typing import Any

import numpy as np

from validate.fmu_check.comparison import compare
from validate.fmu_check.faults import Misbehaviour
from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.motion import run
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.states import begin_varied, can_save
from validate.fmu_check.subject import Subject

# Steps of instances that are stepped in turn.
_IN_TURN = 20
# Runs before memory is measured, batches that are measured, runs in each (at most), seconds for all.
_WARM, _BATCHES, _RUNS, _LEAK_SECONDS = 25, 6, 40, 3.0
# Bytes a run may keep: the least that malloc gives is 32, what is less on average is its noise.
_KEPT = 24.0
_RESIDENT_KEPT = 1024.0


@check("runs repeat", "two fresh instances with the same inputs give the same bits", Scope.EACH)
def repeats(subject: Subject, kind: str) -> Finding:
    steps = subject.steps(kind)
    runs = []
    for name in ("first", "second"):
        with new_instance(subject, kind, name) as instance:
            runs.append(run(instance.begin(), 0, steps))
    apart = compare(subject, *runs)
    if not apart.equal:
        return failed(f"in a second run, {apart.where(subject)}.")
    return passed(f"{runs[0].shape[1]} values over {len(runs[0]) - 1} steps: equal bits.")


@check("reset equals a fresh instance", "after a run with other parameters and inputs, reset forgets all of it", Scope.EACH)
def resets(subject: Subject, kind: str) -> Finding:
    steps = subject.steps(kind)
    with new_instance(subject, kind, "fresh") as instance:
        reference = run(instance.begin(), 0, steps)
    with new_instance(subject, kind, "reset") as instance:
        for terminated in (True, False):
            begin_varied(instance)
            run(instance, 0, steps // 2, seed=1, observe="end")
            if terminated:
                instance.fmu.terminate()
            instance.reset()
            apart = compare(subject, reference, run(instance.begin(), 0, steps))
            if not apart.equal:
                return failed(f"after reset{' from a terminated run' if terminated else ''}, {apart.where(subject)}.")
            instance.reset()
    return passed(f"reset after and without terminate, then {len(reference) - 1} steps each: equal bits.")


@check("instances do not disturb each other", "two instances stepped in turn give what each gives alone", Scope.EACH)
def independent(subject: Subject, kind: str) -> Finding:
    if subject.can(kind, "canBeInstantiatedOnlyOncePerProcess"):
        return not_offered("canBeInstantiatedOnlyOncePerProcess is true.")
    steps = min(subject.steps(kind), _IN_TURN)
    alone = []
    for seed in (0, 1):
        with new_instance(subject, kind, f"alone {seed}") as instance:
            _begin_as(instance, seed)
            alone.append(np.array(list(_stepwise(instance, steps, seed))))
    pair: list[Instance] = [new_instance(subject, kind, f"pair {seed}") for seed in (0, 1)]
    for seed, instance in enumerate(pair):
        _begin_as(instance, seed)
    together = [_stepwise(instance, steps, seed) for seed, instance in enumerate(pair)]
    rows = [list(item) for item in zip(*itertools.zip_longest(*together), strict=True)]
    for instance in pair:
        instance.close()
    for seed in (0, 1):
        apart = compare(subject, alone[seed], np.array([row for row in rows[seed] if row is not None]))
        if not apart.equal:
            return failed(f"beside another instance, {apart.where(subject, 1)}.")
    return passed(f"{steps} steps each in turn, with different parameters and inputs: equal bits.")


def _begin_as(instance: Instance, seed: int) -> None:
    if seed:
        begin_varied(instance)
    else:
        instance.begin()


def _stepwise(instance: Instance, steps: int, seed: int):
    """The values after each step, one at a time."""
    for step in range(steps):
        yield run(instance, step, step + 1, seed=seed, observe="end")[0]


@check(
    "freed instances give memory back",
    "instantiating, running, saving states and freeing again and again does not grow the process",
    Scope.EACH,
)
def leaks(subject: Subject, kind: str) -> Finding:
    instance = new_instance(subject, kind)
    saves = can_save(subject, kind)

    made = 1

    def once() -> None:
        nonlocal made
        if not instance.fmu.component:
            try:
                instance.again()
            except Misbehaviour as error:
                raise Misbehaviour(f"{error}, after {made} others were freed") from error
        instance.begin()
        if kind == "CS":
            for step in range(3):
                instance.do_step(subject.time(step), subject.step)
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
    runs = int(np.clip(_LEAK_SECONDS / _BATCHES / ((time.perf_counter() - began) / 5 + 1e-6), 3, _RUNS))
    for _ in range(_WARM):
        once()
    marks = [_memory()]
    for _ in range(_BATCHES):
        for _ in range(runs):
            once()
        marks.append(_memory())
    grown = np.diff(np.array(marks), axis=0) / runs
    for column, (what, kept) in enumerate((("allocated", _KEPT), ("resident", _RESIDENT_KEPT))):
        # A leak grows in every batch; what settles, or jumps once, is no leak.
        if np.min(grown[:, column]) > 0.0 and np.median(grown[:, column]) >= kept:
            return failed(f"each run keeps {np.median(grown[:, column]):.0f} bytes of {what} memory ({runs * _BATCHES} runs).")
    return passed(f"{runs * _BATCHES} runs: {max(0.0, np.median(grown[:, 0])):.0f} bytes kept by each.")


class _MallocInfo(ctypes.Structure):
    """struct mallinfo2 of the GNU C library."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    ]


@lru_cache(maxsize=1)
def _mallinfo2() -> Any:
    """The function of the GNU C library; None with another one."""
    try:
        function = ctypes.CDLL(None).mallinfo2
    except (AttributeError, OSError, TypeError):
        return None
    function.restype = _MallocInfo
    return function


def _memory() -> tuple[float, float]:
    """(bytes allocated on the heap, bytes resident), Python's own garbage collected; 0 where the system does not tell."""
    gc.collect()
    allocated = resident = 0.0
    mallinfo2 = _mallinfo2()
    if mallinfo2 is not None:
        info = mallinfo2()
        allocated = float(info.uordblks + info.hblkhd)
    if os.path.exists("/proc/self/statm"):
        with open("/proc/self/statm", encoding="ascii") as file:
            resident = float(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return allocated, resident
