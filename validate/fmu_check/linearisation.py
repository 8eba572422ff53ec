"""Points at which an FMU is a function of its states and inputs: where derivatives and dependencies are looked at."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.motion import Record, run
from validate.fmu_check.subject import Subject, Variable

# Where in a run points are taken, and after how many of its first events.
AFTER_EVENTS = 4
SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
# Of a large FMU, columns are drawn.
MOST_KNOWNS = 60


@dataclass
class Point:
    """An instance at a point: `evaluate` maps the knowns (their entries in order) to the unknowns, and leaves the instance at the point after back()."""

    where: str
    instance: Instance
    knowns: list[Variable]
    unknowns: list[Variable]
    x: np.ndarray
    time: float
    state_entries: int

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        if self.state_entries:
            self.instance.move(self.time, x[: self.state_entries])
        given = [item for item in self.knowns if item not in self._states]
        if given:
            self.instance.set(given, x[self.state_entries :])
        return self.instance.get(self.unknowns)

    def back(self) -> None:
        self.evaluate(self.x)

    @property
    def _states(self) -> list[Variable]:
        return self.instance.subject.states if self.state_entries else []

    def sizes(self) -> np.ndarray:
        return np.concatenate([np.full(item.size, item.scale) for item in self.knowns])

    def entries(self) -> list[tuple[int, Variable]]:
        """(place in x, known) of the entries to look at: all, or some of a large FMU."""
        every = [item for item in self.knowns for _ in range(item.size)]
        places = range(len(every))
        if len(every) > MOST_KNOWNS:
            places = sorted(np.random.default_rng(3).choice(len(every), MOST_KNOWNS, replace=False).tolist())
        return [(place, every[place]) for place in places]

    def names(self) -> list[str]:
        """Of the unknowns' entries."""
        return [item.name for item in self.unknowns for _ in range(item.size)]


def points(subject: Subject, kind: str) -> Iterator[Point]:
    """Points along a run: unknowns are derivatives and outputs, knowns are states and continuous inputs (Co-Simulation: inputs, outputs)."""
    steps = subject.long_steps(kind)
    exchange = kind == "ME"
    outputs = [item for item in subject.outputs if item.is_float]
    states = (
        subject.states
        if exchange and sum(item.size for item in subject.states) == int(subject.description.numberOfContinuousStates)
        else []
    )
    knowns = [*states, *subject.continuous_inputs]
    unknowns = [*(subject.derivatives if exchange else []), *outputs]
    if not knowns or not unknowns:
        return
    count = sum(item.size for item in states)
    places = _places(subject, kind, steps)
    with new_instance(subject, kind) as instance:
        instance.begin()
        for before, place in itertools.pairwise([0, *places]):
            if place > before:
                run(instance, before, place, observe="end")
            x = np.concatenate([instance.states() if count else np.empty(0), instance.get(subject.continuous_inputs)])
            point = Point(f"at t = {subject.time(place):.6g} s", instance, knowns, unknowns, x, subject.time(place), count)
            yield point
            point.back()


def _places(subject: Subject, kind: str, steps: int) -> list[int]:
    """Steps at whose ends to look: spread over the run, and just after the first events, where other equations hold."""
    places = {int(share * steps) for share in SHARES}
    if kind == "ME":
        record = Record()
        with new_instance(subject, kind, "events") as instance:
            run(instance.begin(), 0, steps, observe="end", record=record)
        ends = [math.ceil((time - subject.start_time) / subject.step) for time, crossed, _ in record.events if crossed]
        # Where events crowd, a run that starts afresh at each point could not follow.
        last = math.floor((min(record.crowded, subject.time(steps)) - subject.start_time) / subject.step) - 1
        places = {place for place in places | set(list(dict.fromkeys(ends))[:AFTER_EVENTS]) if place <= max(last, 0)}
    return sorted(places)


def initial_point(subject: Subject, kind: str) -> Point | None:
    """In Initialization Mode: unknowns are those of the ModelStructure, knowns all that has an exact start; None if there are none or it is refused."""
    unknowns = [item for item in subject.of(subject.description.initialUnknowns) if item.is_float]
    knowns = [
        item
        for item in subject.variables
        if item.is_float
        and item.start is not None
        and item.variability != "constant"
        and (item.initial == "exact" or item.causality == "input")
    ]
    if not knowns or not unknowns:
        return None
    instance = new_instance(subject, kind, "initial")
    instance.setup(subject.start_time, None)
    # A little off the starts, where symmetric models have kinks and zeros.
    instance.set_all(subject.varied_parameters())
    instance.enter_initialisation(subject.start_time, None)
    point = Point("in Initialization Mode", instance, knowns, unknowns, instance.get(knowns), subject.start_time, 0)
    try:
        point.back()
    except FMICallException:
        return None
    return point
