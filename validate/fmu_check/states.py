"""The memory of an instance: saved states, runs that repeat, reset, and other instances."""

from __future__ import annotations

import itertools
import mmap
from collections.abc import Iterator
from typing import Any

import numpy as np

from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Finding, Scope, check, failed, in_fork, not_offered, passed
from validate.fmu_check.motion import (
    SAFETY,
    compare,
    fresh_run,
    require_equal,
    restart_limit,
    run,
)
from validate.fmu_check.subject import HOLD, CheckedInstance, Subject

# Shares of a run after which states are saved.
_SHARES = (0.0, 0.3, 0.7)
# An error of an integrator that restarts shrinks with this tolerance ...
_TIGHT = 1e-8
# ... at least to this share: a hundredth is expected of the FMU's own tolerance, 1e-6 at most.
_SHRUNK = 0.1
# Time of one half of the serialisation check [s]: both fit into the time limit of a check.
_HALF_SECONDS = 25.0
# Memory taken before the FMU is loaded a second time [bytes]: the FMU lies elsewhere, so that an
# address among the bytes shows.
_SHIFT = 37 * 1024**2

# Names of the abilities in FMI 2.0 and 3.0.
SAVES = ("canGetAndSetFMUstate", "canGetAndSetFMUState")
_SERIALISES = ("canSerializeFMUstate", "canSerializeFMUState")


@check("set state restores", Scope.EACH, clauses=("2.1.8", "2.2.7.4"), needs=SAVES)
def restores(subject: Subject, kind: str) -> Finding:
    """A saved state, set again after other steps and other inputs, continues as the first time."""
    steps = subject.steps(kind)
    length = max(2, steps // 4)
    worst, limit = 0.0, restart_limit(subject)
    places = sorted({int(share * (steps - length)) for share in _SHARES})
    for place in places:
        with CheckedInstance(subject, kind).begin_varied() as instance:
            before = run(instance, 0, place, observe="end")
            saved, next_event = instance.save(), instance.next_event
            reference = run(instance, place, place + length)
            run(instance, place + length, place + 2 * length, seed=1)  # with other inputs
            state = f"the state saved at t = {subject.time(place):.6g} s"
            for turn in ("", "a second time "):
                _restore(instance, saved, next_event, place)
                _, where = compare(subject, before, instance.observe()[None], place)
                if where:
                    return failed(f"{state} was set {turn}again, but {where}.")
                again = run(instance, place, place + length)
                share, where = compare(subject, reference, again, place)
                if share > limit and limit == restart_limit(subject):
                    limit = max(limit, _restart_error(subject, kind, place, length))
                if share > limit:
                    return failed(f"continued {turn}from {state}, {where}.")
                worst = max(worst, share)
            instance.forget(saved)
    turns = f"saved at {len(places)} times, set twice each, continued for {length} steps"
    return passed(f"{turns}: {_how_equal(worst)}.")


def _how_equal(share: float) -> str:
    if share == 0.0:
        return "equal bits"
    return f"equal to {share:.1g} of their size (its integrator starts afresh)"


def _restart_error(subject: Subject, kind: str, first: int, length: int) -> float:
    """Return the error of an FMU's integrator that restarts at a set state, as a share of a size.

    The error shrinks with the FMU's tolerance; forgotten state does not. 0 if it does not shrink.
    """
    if kind != "CS":
        return 0.0
    shares = []
    for tolerance in (None, _TIGHT):
        with CheckedInstance(subject, kind, f"tolerance {tolerance}") as instance:
            instance.tolerance = tolerance
            run(instance.begin_varied(), 0, first, observe="end")
            saved = instance.save()
            reference = run(instance, first, first + length)
            instance.restore(saved)
            again = run(instance, first, first + length)
            shares.append(compare(subject, reference, again)[0])
    return SAFETY * shares[0] if shares[1] <= _SHRUNK * shares[0] else 0.0


def _restore(instance: CheckedInstance, saved: Any, next_event: float, step: int) -> None:
    """Set a saved state.

    Time and next event of Model Exchange belong to the importer, and need not be part of it.
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
            is_same = data == instance.fmu.serializeFMUState(saved)
            rows = run(instance, place, place + length).tolist()
        return {"data": data.hex(), "is_same": is_same, "rows": rows, "next": next_event}

    def second(data: bytes, next_event: float) -> list[list[float]]:
        with mmap.mmap(-1, _SHIFT):
            others = [CheckedInstance(subject, kind, f"other {number}") for number in range(3)]
            with CheckedInstance(subject, kind).begin() as instance:
                _restore(instance, instance.fmu.deserializeFMUState(data), next_event, place)
                rows = run(instance, place, place + length).tolist()
            for other in others:
                other.free()
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
    if not found["is_same"]:
        return failed("one state serialised twice gives different bytes.")
    saved = f"{len(found['data']) // 2} bytes saved at t = {subject.time(place):.6g} s"
    return passed(f"{saved}, continued for {length} steps: {_how_equal(share)}.")


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
    steps = min(subject.steps(kind), 2 * HOLD)

    def in_turn(name: str, *seeds: int) -> Iterator[np.ndarray]:
        """Yield (steps + 1, observed) [unit of each variable] of an instance for each seed.

        Each instance is read again after a step of another one. Raises as `run`; Failed if that
        read differs.
        """
        instances = {seed: CheckedInstance(subject, kind, f"{name} {seed}") for seed in seeds}
        for seed, instance in instances.items():
            instance.begin_varied() if seed else instance.begin()
        rows = {seed: [instance.observe()] for seed, instance in instances.items()}
        for step, (seed, instance) in itertools.product(range(steps), instances.items()):
            rows[seed].append(run(instance, step, step + 1, seed=seed, observe="end")[0])
            for other in instances.keys() - {seed}:
                last, again = np.array(rows[other][-1:]), instances[other].observe()[None]
                place = len(rows[other]) - 1
                require_equal(subject, last, again, "after a step of another instance", place)
        for instance in instances.values():
            instance.close()
        yield from map(np.array, rows.values())

    alone = [*in_turn("alone", 0), *in_turn("alone", 1)]
    for one, paired in zip(alone, in_turn("pair", 0, 1), strict=True):
        require_equal(subject, one, paired, "beside another instance")
    return passed(
        f"{steps} steps each in turn, with different parameters and inputs, each read again after "
        "the other's step: equal bits."
    )
