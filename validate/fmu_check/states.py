"""Saved states: setting one restores everything, and a serialised one continues in another process."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

from validate.fmu_check.comparison import compare, restart_limit
from validate.fmu_check.faults import Ended, Misbehaviour
from validate.fmu_check.forked import Answer, in_fork
from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.motion import run
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import Subject

# Where in a run states are saved.
_SHARES = (0.0, 0.3, 0.7)
# The error of an integrator that starts afresh: with this tolerance it is at most this share of what it is with the FMU's own, and at different times
# it varies by such a factor.
_TIGHT, _SHRUNK, _SAFETY = 1e-8, 0.1, 4.0
# Seconds for one half of the serialisation check.
_HALF_SECONDS = 25.0
# Memory taken before the FMU is loaded a second time, so that nothing lies where it lay: an address in the bytes shows.
_SHIFT = 37 * 1024**2

# How FMI spells it.
STATE = {2: "state", 3: "State"}


def can_save(subject: Subject, kind: str) -> bool:
    """Whether states can be got and set."""
    return subject.can(kind, f"canGetAndSetFMU{STATE[subject.major]}")


@check("set state restores", "a saved state, set again after other steps and other inputs, continues as the first time", Scope.EACH)
def restores(subject: Subject, kind: str) -> Finding:
    if not can_save(subject, kind):
        return not_offered(f"canGetAndSetFMU{STATE[subject.major]} is false.")
    steps = subject.steps(kind)
    length = max(2, steps // 4)
    worst, limit = 0.0, restart_limit(subject)
    places = sorted({int(share * (steps - length)) for share in _SHARES})
    for place in places:
        with new_instance(subject, kind) as instance:
            begin_varied(instance)
            if place:
                run(instance, 0, place)
            before = instance.observe()
            saved, next_event = instance.save(), instance.next_event
            reference = run(instance, place, place + length)
            run(instance, place + length, place + 2 * length, seed=1)  # elsewhere, with other inputs
            for turn in ("", "a second time "):
                instance.restore(saved)
                at_time(instance, place)
                apart = compare(subject, before[np.newaxis], instance.observe()[np.newaxis])
                if not apart.equal:
                    return failed(
                        f"the state saved at t = {subject.time(place):.6g} s was set {turn}again, but {apart.where(subject, place)}."
                    )
                instance.next_event = next_event
                apart = compare(subject, reference, run(instance, place, place + length))
                if apart.share > limit and limit == restart_limit(subject):
                    limit = max(limit, _restart_error(subject, kind, place, length))
                if apart.share > limit:
                    where = apart.where(subject, place)
                    return failed(f"continued {turn}from the state saved at t = {subject.time(place):.6g} s, {where}.")
                worst = max(worst, apart.share)
            instance.forget(saved)
    told = "equal bits" if worst == 0.0 else f"equal to {worst:.1g} of their size (its integrator starts afresh)"
    return passed(f"saved at {len(places)} times, set twice each, continued for {length} steps: {told}.")


def _restart_error(subject: Subject, kind: str, first: int, length: int) -> float:
    """How far a run that goes on from a set state may be from the first one, as a share of a variable's size, because the FMU's integrator starts afresh.

    That error shrinks with the FMU's tolerance; what was forgotten does not. 0 where a tighter tolerance does not help.
    """
    shares = []
    for tolerance in (None, _TIGHT) if kind == "CS" else ():
        with new_instance(subject, kind, f"tolerance {tolerance}") as instance:
            instance.tolerance = tolerance
            begin_varied(instance)
            if first:
                run(instance, 0, first)
            saved = instance.save()
            reference = run(instance, first, first + length)
            instance.restore(saved)
            at_time(instance, first)
            shares.append(compare(subject, reference, run(instance, first, first + length)).share)
    return _SAFETY * shares[0] if shares and shares[1] <= _SHRUNK * shares[0] else 0.0


def at_time(instance: Instance, step: int) -> None:
    """Tell a Model Exchange FMU the time again: it is given from outside, and need not be part of a saved state."""
    if instance.kind == "ME":
        instance.set_time(instance.subject.time(step))


def begin_varied(instance: Instance) -> None:
    """Begin with other parameters than a fresh instance has, so that a forgotten one shows; with its own if it refuses those."""
    from fmpy.fmi1 import FMICallException

    try:
        instance.begin(before=instance.subject.varied_parameters())
    except FMICallException:
        instance.reset()
        instance.begin()


@check("serialised state loads elsewhere", "the bytes of a state, loaded in a new process, continue as the first process did", Scope.EACH)
def serialises(subject: Subject, kind: str) -> Finding:
    if not subject.can(kind, f"canSerializeFMU{STATE[subject.major]}"):
        return not_offered(f"canSerializeFMU{STATE[subject.major]} is false.")
    steps = subject.steps(kind)
    place, length = steps // 2, max(2, steps // 4)

    def first() -> dict[str, Any]:
        with new_instance(subject, kind) as instance:
            begin_varied(instance)
            run(instance, 0, place)
            saved, next_event = instance.save(), instance.next_event
            data = instance.serialise(saved)
            again = instance.serialise(saved)
            rows = run(instance, place, place + length)
        return {"data": data.hex(), "same": data == again, "rows": rows.tolist(), "next": next_event}

    def second(data: bytes, next_event: float) -> list[list[float]]:
        junk = mmap.mmap(-1, _SHIFT)
        others = [new_instance(subject, kind, f"other {number}") for number in range(3)]
        with new_instance(subject, kind) as instance:
            instance.begin()
            saved = instance.deserialise(data)
            instance.restore(saved)
            at_time(instance, place)
            instance.next_event = next_event
            rows = run(instance, place, place + length).tolist()
        for other in others:
            other.free()
        junk.close()
        return rows

    wrote = in_fork(lambda: _caught(first), _HALF_SECONDS)
    _end_as(wrote)
    if wrote.problem or "problem" in wrote.value:
        return failed(f"while a state was serialised: {(wrote.problem or wrote.value['problem']).rstrip('.')}.")
    found = wrote.value["value"]
    read = in_fork(lambda: _caught(lambda: second(bytes.fromhex(found["data"]), found["next"])), _HALF_SECONDS)
    _end_as(read)
    if read.problem or "problem" in read.value:
        return failed(f"in a new process: {(read.problem or read.value['problem']).rstrip('.')}.")
    reference, rows = np.array(found["rows"]), np.array(read.value["value"])
    apart = compare(subject, reference, rows)
    if apart.share > restart_limit(subject) and apart.share > _restart_error(subject, kind, place, length):
        return failed(f"continued in a new process from the serialised state, {apart.where(subject, place)}.")
    if not found["same"]:
        return failed("one state serialised twice gives different bytes.")
    told = "equal bits" if apart.equal else f"equal to {apart.share:.1g} of their size (its integrator starts afresh)"
    return passed(f"{len(found['data']) // 2} bytes saved at t = {subject.time(place):.6g} s, continued for {length} steps: {told}.")


def _end_as(answer: Answer) -> None:
    """Raise Ended if the FMU ended the run in the fork."""
    if not answer.problem and "ended" in answer.value:
        raise Ended(answer.value["ended"])


def _caught(function: Any) -> dict[str, Any]:
    """What it gives, or what the FMU refused, or when it ended, as JSON."""
    from fmpy.fmi1 import FMICallException

    try:
        return {"value": function()}
    except Ended as end:
        return {"ended": end.time}
    except (Misbehaviour, FMICallException) as error:
        return {"problem": str(error)}
