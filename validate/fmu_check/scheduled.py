"""Scheduled Execution of FMI 3.0: clocks, and the model partitions that they activate.

The schedule is made here as the standard gives it to the importer: periodic clocks by their intervals, countdown clocks by the interval the FMU tells once
another partition has run, triggered ones whenever somebody likes - here every second tick of the fastest. At one time the smaller priority comes first.
"""

from __future__ import annotations

import ctypes
import heapq
import math
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import fmi3Float64, fmi3IntervalChanged, fmi3IntervalQualifier, fmi3ValueReference

from validate.fmi.archive import DESCRIPTION
from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import CheckedInstance, Subject

# Ticks of the fastest clock in a run, activations at most, and what may count as an interval's qualifier.
_TICKS, _MOST, _QUALIFIERS = 20, 10_000, (0, 1, 2)


class _Clock(NamedTuple):
    """A clock of the description, of which FMPy reads less. variability: of its interval; interval: as it stands there [s]."""

    name: str
    reference: int
    causality: str
    variability: str
    priority: int
    interval: float | None


def _clock(item: ElementTree.Element) -> _Clock:
    """Raises ValueError for what is no number."""
    counter, decimal = item.get("intervalCounter"), item.get("intervalDecimal")
    interval = float(decimal) if decimal else float(counter) / float(item.get("resolution", "1")) if counter else None
    head = item.get("name", ""), int(item.get("valueReference", "0")), item.get("causality", "local"), item.get("intervalVariability", "")
    return _Clock(*head, int(item.get("priority", "0")), interval)


@check("clocks and their partitions", Scope.SCHEDULED, clauses=("", "5.1"))
def activated(subject: Subject, kind: str) -> Finding:
    """Each input clock's partition can be activated when its time comes, locks are given back, intervals make sense, and a second run is the same."""
    found = [_clock(item) for item in ElementTree.parse(subject.folder / DESCRIPTION).iter("Clock")]
    clocks = [item for item in found if item.causality == "input"]
    outputs = [item.reference for item in found if item.causality == "output"]
    if not clocks:
        return not_offered("it has no input clocks.")
    first, log = _run(subject, kind, clocks, outputs)
    second, _ = _run(subject, kind, clocks, outputs)
    if not np.array_equal(first, second, equal_nan=True):
        return failed("a second run with the same activations gives other values.")
    if not np.isfinite(first).all():
        return failed("a value is no finite number.")
    counts = ", ".join(f"{item.name} {log[item.name]} times" for item in clocks)
    return passed(f"activated: {counts}; {log['']} updates of clocks asked for; {first.shape[1]} values, equal bits in a second run.")


def _run(subject: Subject, kind: str, clocks: list[_Clock], outputs: list[int]) -> tuple[np.ndarray, dict[str, int]]:
    """Values after each activation, and how often each clock was active; under "" how often the FMU asked for a look at its clocks."""
    log: dict[str, int] = {item.name: 0 for item in clocks} | {"": 0}
    held = [0]
    asked = [False]

    def update(_environment: Any) -> None:
        log[""] += 1
        asked[0] = True

    def lock() -> None:
        held[0] += 1

    def unlock() -> None:
        held[0] -= 1

    by_reference = {item.reference: item for item in clocks}
    with CheckedInstance(subject, kind, options={"clockUpdate": update, "locks": (lock, unlock)}) as instance:
        instance.begin()
        periods = {item.reference: _period(instance, item) for item in clocks}
        fastest = min((period for period in periods.values() if math.isfinite(period)), default=subject.step)
        end = subject.start_time + _TICKS * fastest
        schedule = [(subject.start_time, item.priority, item.reference) for item in clocks if item.variability not in ("countdown",)]
        heapq.heapify(schedule)
        rows = []
        while schedule and schedule[0][0] < end and len(rows) < _MOST:
            time, priority, reference = heapq.heappop(schedule)
            item = by_reference[reference]
            try:
                instance.fmu.fmi3ActivateModelPartition(instance.fmu.component, reference, time)
            except FMICallException as error:
                raise Misbehaviour(
                    f"the partition of {item.name} cannot be activated at t = {time:.6g} s ({str(error).rstrip('.')}){instance.quote()}"
                ) from error
            log[item.name] += 1
            if held[0]:
                raise Misbehaviour(
                    f"after the partition of {item.name} ran at t = {time:.6g} s, {held[0]} locks of preemption are not given back"
                )
            if outputs:
                instance.fmu.getClock(outputs)
            rows.append(instance.observe())
            period = {"countdown": math.inf, "triggered": 2.0 * fastest}.get(item.variability, periods[reference])
            if math.isfinite(period):
                heapq.heappush(schedule, (time + period, priority, reference))
            if asked[0]:
                asked[0] = False
                for other in clocks:
                    wait = _interval(instance, other) if other.variability in ("countdown", "changing") else math.inf
                    if math.isfinite(wait) and other.variability == "countdown":
                        heapq.heappush(schedule, (time + wait, other.priority, other.reference))
                    elif math.isfinite(wait):
                        periods[other.reference] = wait
    return np.array(rows), log


def _period(instance: CheckedInstance, item: _Clock) -> float:
    """Seconds between two ticks of a periodic clock; infinite for others. Raises Misbehaviour."""
    if item.variability in ("triggered", "countdown"):
        return math.inf
    return _interval(instance, item) if item.interval is None else item.interval


def _interval(instance: CheckedInstance, item: _Clock) -> float:
    """What fmi3GetIntervalDecimal tells of a clock [s]; infinite where it has not changed. Raises Misbehaviour."""
    interval, qualifier = (fmi3Float64 * 1)(), (fmi3IntervalQualifier * 1)()
    instance.fmu.getIntervalDecimal(
        (fmi3ValueReference * 1)(item.reference), interval, ctypes.cast(qualifier, ctypes.POINTER(fmi3IntervalQualifier))
    )
    if qualifier[0] not in _QUALIFIERS:
        raise Misbehaviour(f"the interval of {item.name} has the qualifier {qualifier[0]}; there are 0, 1 and 2")
    if qualifier[0] != fmi3IntervalChanged:
        return math.inf
    if not (math.isfinite(interval[0]) and (interval[0] > 0.0 or (interval[0] == 0.0 and item.variability == "countdown"))):
        raise Misbehaviour(f"the interval of {item.name} is told as {interval[0]:g} s")
    return float(interval[0])
