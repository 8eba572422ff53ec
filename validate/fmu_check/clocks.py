"""Clocks of FMI 3.0: ticks in Event Mode of Model Exchange and Co-Simulation, activated model partitions of Scheduled Execution.

The schedule is made here as the standard gives it to the importer: periodic clocks by their shifts
and intervals, changing and countdown ones by the intervals that the FMU tells, triggered ones
whenever somebody likes - here every second tick of the fastest. Clocked variables are read, and
inputs among them set, only while a clock of theirs ticks.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import (
    fmi3Float64,
    fmi3IntervalChanged,
    fmi3IntervalQualifier,
    fmi3UInt64,
    fmi3ValueReference,
)

from validate.fmi.archive import DESCRIPTION
from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Failed, Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.communication import MIGHT_RETURN, EventStepping
from validate.fmu_check.motion import TOLERANCE, Crowded, Exchange
from validate.fmu_check.subject import Block, CheckedInstance, Subject

# Ticks of the fastest clock in a run, activations at most, and what may count as an interval's
# qualifier.
_TICKS = 20
_MOST = 10_000
_QUALIFIERS = (0, 1, 2)
# Two ticks are at one time if they are nearer than this share of a step and of the shortest
# interval.
_SAME = 1e-6
# Clocked inputs are moved by this share of their size.
_MOVED = 0.01


class _Clock(NamedTuple):
    """A clock of the description, of which FMPy reads less. variability: of its interval.

    interval, shift: as they stand there [s]; clocks: of which it is clocked itself.
    """

    name: str
    reference: int
    causality: str
    variability: str
    priority: int
    interval: float | None
    shift: float
    clocks: tuple[int, ...]
    fraction: bool


def _clock(item: ElementTree.Element) -> _Clock:
    """Raises ValueError for what is no number."""

    def seconds(name: str) -> float | None:
        counter, decimal = item.get(f"{name}Counter"), item.get(f"{name}Decimal")
        return (
            float(decimal)
            if decimal
            else float(counter) / float(item.get("resolution", "1"))
            if counter
            else None
        )

    head = (
        item.get("name", ""),
        int(item.get("valueReference", "0")),
        item.get("causality", "local"),
        item.get("intervalVariability", ""),
    )
    parents = tuple(map(int, item.get("clocks", "").split()))
    times = (
        seconds("interval"),
        seconds("shift") or 0.0,
        parents,
        item.get("supportsFraction") in ("true", "1"),
    )
    return _Clock(*head, int(item.get("priority", "0")), *times)


def _clocks_of(subject: Subject) -> tuple[list[_Clock], list[_Clock]]:
    """Input clocks and output clocks. Raises Failed."""
    try:
        found = [
            _clock(item) for item in ElementTree.parse(subject.folder / DESCRIPTION).iter("Clock")
        ]
    except (ValueError, ZeroDivisionError) as error:
        raise Failed(
            f"the interval, shift or priority of a clock is no number that can be used ({error})."
        ) from error
    return [item for item in found if item.causality == "input"], [
        item for item in found if item.causality == "output"
    ]


class _Schedule:
    """When which input clock ticks; made in Initialization Mode. end: of the run [s].

    Raises Misbehaviour for intervals that make no sense.
    """

    def __init__(self, instance: CheckedInstance, clocks: Sequence[_Clock]) -> None:
        subject, self._instance, self.clocks = instance.subject, instance, clocks
        self._start, self._next, self._periods = (
            subject.start_time,
            dict[_Clock, float](),
            dict[int, float](),
        )
        for item in clocks:
            if item.variability == "triggered":
                self._push(self._start, item)
                continue
            wait = item.interval if item.interval is not None else self._ask(item)
            if item.variability in ("countdown", "changing"):
                self._push(self._start + wait, item)
            else:
                self._push(
                    self._start + (item.shift if item.interval is not None else self._shift(item)),
                    item,
                )
            if 0.0 < wait < math.inf and item.variability != "countdown":
                self._periods[item.reference] = wait
        self._fastest = min(self._periods.values(), default=subject.step)
        self.near = _SAME * min(self._fastest, subject.step)
        self.end = self._start + _TICKS * self._fastest

    def _push(self, time: float, item: _Clock) -> None:
        if math.isfinite(time):
            self._next[item] = time

    @property
    def time(self) -> float:
        """Of the next tick [s]; infinite where there is none before the end."""
        time = min(self._next.values(), default=math.inf)
        return time if time < self.end - self.near else math.inf

    def pop(self) -> _Clock:
        """The clock that ticks next."""
        first = min(self._next, key=lambda item: (self._next[item], item.priority, item.reference))
        del self._next[first]
        return first

    def go_on(self, time: float, ticked: Sequence[_Clock], *, updated: bool = True) -> None:
        """When clocks that have ticked do so again.

        updated: whether countdown clocks are to be looked at.
        """
        for item in ticked:
            if item.variability == "triggered":
                self._push(time + 2.0 * self._fastest, item)
            elif item.variability == "changing":
                self._push(time + self._ask(item), item)
            elif item.variability != "countdown":
                self._push(time + self._periods[item.reference], item)
        for item in self.clocks if updated else ():
            if item.variability == "countdown":
                self._push(time + self._ask(item), item)  # what it told before is overwritten

    def _ask(self, item: _Clock) -> float:
        """The interval that the FMU tells of a clock [s].

        Infinite where a countdown has not changed.
        """
        qualifier, decimal = self._told("Decimal", item, fmi3Float64)
        interval = decimal[0]
        if qualifier not in _QUALIFIERS:
            raise Misbehaviour(
                f"the interval of {item.name} has the qualifier {qualifier}; there are 0, 1 and 2"
            )
        if item.variability != "countdown" and qualifier == 0:
            raise Misbehaviour(
                f"the interval of {item.name} is not yet known, which may be so of countdown clocks only"
            )
        if qualifier != fmi3IntervalChanged:
            return self._periods.get(item.reference, math.inf)
        if not (
            math.isfinite(interval)
            and (
                interval > 0.0
                or (interval == 0.0 and item.variability in ("countdown", "changing"))
            )
        ):
            raise Misbehaviour(f"the interval of {item.name} is told as {interval:g} s")
        if item.fraction:
            _, (counter, resolution) = self._told("Fraction", item, fmi3UInt64, fmi3UInt64)
            if not (resolution and abs(counter / resolution - interval) <= 1e-9 * interval):
                raise Misbehaviour(
                    f"the interval of {item.name} is told as {interval:.9g} s, and as the fraction {counter}/{resolution}"
                )
        return interval

    def _told(self, how: str, item: _Clock, *types: Any) -> tuple[int, list[float]]:
        """Qualifier and answers of fmi3GetIntervalDecimal or fmi3GetIntervalFraction."""
        answers, qualifier = [(kind * 1)() for kind in types], (fmi3IntervalQualifier * 1)()
        pointer = ctypes.cast(qualifier, ctypes.POINTER(fmi3IntervalQualifier))
        getattr(self._instance.fmu, f"getInterval{how}")(
            (fmi3ValueReference * 1)(item.reference), *answers, pointer
        )
        return qualifier[0], [answer[0] for answer in answers]

    def _shift(self, item: _Clock) -> float:
        shift = (fmi3Float64 * 1)()
        self._instance.fmu.getShiftDecimal((fmi3ValueReference * 1)(item.reference), shift)
        if not (math.isfinite(shift[0]) and shift[0] >= 0.0):
            raise Misbehaviour(f"the shift of {item.name} is told as {shift[0]:g} s")
        return float(shift[0])


class _Log:
    """What came of a run: how often each clock ticked, "" how often the FMU asked for a look at its clocks; values after each tick, (entries,) each."""

    def __init__(self, clocks: Sequence[_Clock]) -> None:
        self.counts = {item.name: 0 for item in clocks} | {"": 0}
        self.rows: list[np.ndarray] = []


def _judge(runs: Callable[[], _Log], more: Callable[[_Log], str]) -> Finding:
    """Two runs with the same ticks give the same finite values."""
    first, second = runs(), runs()
    if len(first.rows) != len(second.rows) or not all(
        map(partial(np.array_equal, equal_nan=True), first.rows, second.rows)
    ):
        return failed("a second run with the same activations gives other values.")
    if not all(np.isfinite(row).all() for row in first.rows):
        return failed("a value is no finite number.")
    most = max((row.size for row in first.rows), default=0)
    words = ", ".join(f"{name} {count} times" for name, count in first.counts.items() if name)
    return passed(
        f"activated: {words}; {more(first)}; up to {most} values each time, equal bits in a second run."
    )


def _clocked(subject: Subject, references: Sequence[int]) -> Block:
    """The variables that may be read and set while these clocks tick, and only then."""
    return Block(item for item in subject.variables if set(item.clocks) & set(references))


@check("clocks and their partitions", Scope.SCHEDULED, clauses=("", "5.1"))
def activated(subject: Subject, kind: str) -> Finding:
    """Each input clock's partition can be activated when its time comes, locks are given back, intervals make sense, and a second run is the same."""
    clocks, outputs = _clocks_of(subject)
    if not clocks:
        return not_offered("it has no input clocks.")
    return _judge(
        lambda: _scheduled(subject, kind, clocks, outputs),
        lambda log: f"{log.counts['']} updates of clocks asked for",
    )


def _scheduled(subject: Subject, kind: str, clocks: list[_Clock], outputs: list[_Clock]) -> _Log:
    """Each clock's partition is run when its time comes.

    At one time the smaller priority comes first.
    """
    log, held, asked = _Log(clocks), [0], [False]

    def update(_environment: Any) -> None:
        log.counts[""] += 1
        asked[0] = True

    def lock() -> None:
        held[0] += 1

    def unlock() -> None:
        held[0] -= 1

    with CheckedInstance(
        subject, kind, options={"clockUpdate": update, "locks": (lock, unlock)}
    ) as instance:
        instance.setup()
        instance.enter_initialisation()
        schedule = _Schedule(instance, clocks)
        instance.finish_initialisation()
        readable = {
            item.reference: Block([*subject.observed, *_clocked(subject, [item.reference])])
            for item in clocks
        }
        while math.isfinite(time := schedule.time) and len(log.rows) < _MOST:
            item = schedule.pop()
            try:
                instance.fmu.fmi3ActivateModelPartition(
                    instance.fmu.component, item.reference, time
                )
            except FMICallException as error:
                raise instance.refused(
                    f"the partition of {item.name} cannot be activated at t = {time:.6g} s", error
                ) from error
            log.counts[item.name] += 1
            if held[0]:
                raise Misbehaviour(
                    f"after the partition of {item.name} ran at t = {time:.6g} s, {held[0]} locks of preemption are not given back"
                )
            if outputs:
                instance.fmu.getClock([output.reference for output in outputs])
            log.rows.append(instance.get(readable[item.reference]))
            schedule.go_on(time, [item], updated=asked[0])
            asked[0] = False
    return log


@check("clocks tick in Event Mode", Scope.EACH, clauses=("", "2.3.3"))
def ticking(subject: Subject, kind: str) -> Finding:
    """Input clocks tick when their time comes, clocked variables can be read meanwhile, the FMU ends every tick itself, intervals make sense, and a second run is the same."""
    has = subject.major >= 3 and any(
        item.type == "Clock" for item in subject.description.modelVariables
    )
    clocks, outputs = _clocks_of(subject) if has else ([], [])
    if not clocks and not outputs:
        return not_offered("it has no clocks." if subject.major >= 3 else "FMI 2.0 has none.")
    if kind == "CS" and not subject.can(kind, "hasEventMode"):
        return not_offered("hasEventMode is false, and clocks tick in Event Mode only.")
    if kind == "CS" and not subject.can(kind, "canHandleVariableCommunicationStepSize"):
        return not_offered("ticks need communication steps of any length.")
    return _judge(
        lambda: _ticked(subject, kind, clocks, outputs),
        lambda log: f"{log.counts['']} event iterations",
    )


def _ticked(subject: Subject, kind: str, clocks: list[_Clock], outputs: list[_Clock]) -> _Log:
    """A run through twenty ticks of the fastest clock, with whatever other events the FMU has."""
    with _Ticking(subject, kind, early=subject.can(kind, MIGHT_RETURN)) as instance:
        instance.log, instance.outputs = _Log([*clocks, *outputs]), outputs
        instance.setup()
        instance.enter_initialisation()
        schedule = instance.schedule = _Schedule(instance, clocks)
        instance.fmu.exitInitializationMode()
        instance.settle()
        if kind == "CS":
            instance.step_to(schedule.end)
            return instance.log
        with (
            contextlib.closing(Exchange(instance, TOLERANCE)) as mover,
            contextlib.suppress(Crowded),
        ):
            mover.renew(subject.start_time)
            mover.advance(schedule.end)
        return instance.log


class _Ticking(EventStepping):
    """An instance whose clocks tick when their time comes: a tick is a time event of it."""

    log: _Log
    outputs: list[_Clock]
    schedule: _Schedule

    due: Sequence[_Clock] = ()  # that tick in the round that begins
    ticked: Sequence[_Clock] = ()  # in this event

    def settle(self) -> bool:
        """As of every instance.

        Output clocks and what is clocked are read in each round, intervals at the end.
        """
        ticked = []
        while self.schedule.time <= self.time + self.schedule.near:
            ticked.append(self.schedule.pop())
        references = {item.reference for item in ticked}
        self.ticked, self.due = (
            ticked,
            [item for item in ticked if not item.clocks or references & set(item.clocks)],
        )
        self._activate(self.due)
        changed = super().settle()
        self.next_event = min(self.next_event, self.schedule.time)
        return changed

    def before_update(self) -> None:
        """What ticks is counted, and what is clocked read."""
        active = [*self.due, *self._active()]
        for name in ("", *(item.name for item in active)):
            self.log.counts[name] += 1
        clocked = _clocked(self.subject, [item.reference for item in active])
        try:
            self.log.rows.append(np.concatenate([self.observe(), self.get(clocked)]))
        except FMICallException as error:
            names = " and ".join(item.name for item in active) or "no clock"
            raise self.refused(
                f"while {names} ticks at t = {self.time:.6g} s its variables cannot be read", error
            ) from error
        self.due = ()

    def content(self) -> None:
        """Every tick is over; when the next ones come."""
        for item in self._active():
            raise Misbehaviour(
                f"{item.name} is still active after fmi3UpdateDiscreteStates at t = {self.time:.6g} s, which must end each tick"
            )
        self.schedule.go_on(self.time, self.ticked)

    def _activate(self, due: Sequence[_Clock]) -> None:
        """Let input clocks tick, and set what may be set while they do."""
        if not due:
            return
        try:
            self.fmu.setClock([item.reference for item in due], [True] * len(due))
        except FMICallException as error:
            names = " and ".join(item.name for item in due)
            raise self.refused(
                f"{names} cannot be activated at t = {self.time:.6g} s", error
            ) from error
        clocked = _clocked(self.subject, [item.reference for item in due])
        given = Block(
            item for item in clocked if item.causality == "input" and item.start is not None
        )
        self.set(
            given,
            np.where(given.each(lambda item: item.is_float), given.near(_MOVED), given.starts),
        )

    def _active(self) -> list[_Clock]:
        """Output clocks that tick."""
        states = (
            self.fmu.getClock([item.reference for item in self.outputs]) if self.outputs else ()
        )
        return [item for item, active in zip(self.outputs, states, strict=True) if active]
