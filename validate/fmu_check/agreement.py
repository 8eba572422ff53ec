"""Model Exchange against Co-Simulation: the same motion, as the step shrinks, or within the FMU's tolerance.

Model Exchange is integrated by CVODE with two tolerances, Co-Simulation with the steps h, h/2 and
h/4, all with the same piecewise constant inputs. The difference must be explained: by the error of
either, as the halved step and the other tolerance show it, or by the FMU's tolerance. A state event's
time is as uncertain as the state over its slope, so what jumps there is compared outside that time
alone. Co-Simulation that does not heed the communication step (it has an internal one) is measured
against explicit Euler with its smallest step on the same equations: the plainest integrator of order
one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.motion import JUMP, SAFETY, Crowded, Exchange, by_adams_or_bdf
from validate.fmu_check.subject import HOLD, Block, CheckedInstance, Subject

_RTOLS = (1e-7, 1e-9)
_PARTS = (1, 2, 4)
# Below this share of a value's size nothing is told apart, whatever tolerance the FMU proposes.
_FINEST = 1e-6
# With a larger difference than this share of the value's size nothing was compared [-], nor where
# more than this share of all values is left out: "passed" would say too much.
_COMPARED = 0.1
# Of more values than twice that, every second, third, .. is compared.
_MOST_COMPARED = 10_000


@check("Model Exchange equals Co-Simulation", Scope.FILE)
def agree(subject: Subject) -> Finding:
    """As the step shrinks, or within the FMU's tolerance."""
    if subject.types != ("ME", "CS"):
        return not_offered(f"the FMU offers {' and '.join(subject.types) or 'neither'} only.")
    compared = [
        item
        for item in subject.observed
        if item.is_continuous and item.causality in ("output", "local")
    ]
    if not compared:
        return not_offered("there are no continuous outputs or locals to compare.")
    compared = Block(compared[:: max(1, len(compared) // _MOST_COMPARED)])
    steps = min(subject.long_steps(kind) for kind in subject.types)
    fine, events = by_adams_or_bdf(partial(_integrated, subject, compared, steps, _RTOLS[1]))
    coarse, _ = by_adams_or_bdf(partial(_integrated, subject, compared, len(fine) - 1, _RTOLS[0]))
    length = min(len(fine), len(coarse))
    truth, error, parts, awake = fine[:length], np.abs(fine[:length] - coarse[:length]), {}, 1
    for number in (
        _PARTS if subject.can("CS", "canHandleVariableCommunicationStepSize") else _PARTS[:1]
    ):
        parts[number], awake = _cosimulation(subject, compared, length - 1, number)
    size = np.maximum(np.abs(truth).max(axis=0), 1e-3 * compared.scales)
    finest = parts[max(parts)]
    shrink = np.abs(finest - parts[max(parts) // 2]) if len(parts) > 1 else np.zeros_like(truth)
    tolerated = max(subject.tolerance, _FINEST) * size
    apart, allowed = (
        np.abs(finest - truth),
        tolerated + SAFETY * (_running(shrink) + _running(error)),
    )
    jumps, watched = np.zeros(apart.shape, dtype=bool), None
    if events and not (apart <= allowed).all():
        watched = _Events.of(subject, compared, truth, tolerated)
        allowed, jumps = watched.allowed([shrink, error])
    unexplained, why = ~(apart <= allowed) & ~jumps, ""
    if unexplained.any() and (euler := _euler(subject, compared, length - 1, awake)) is not None:
        own = np.abs(euler - truth)
        if watched is None:
            allowed = allowed + SAFETY * _running(own)
        else:
            allowed, jumps = watched.allowed([shrink, error, own])
        unexplained &= ~(apart <= allowed) & ~jumps
        why = ": no more than explicit Euler has with the smallest of these steps, but it does not shrink with the step, so less cannot be told"
    shares = {
        number: float((np.abs(rows - truth) / size).max(where=~jumps, initial=0.0))
        for number, rows in parts.items()
    }
    shown = ", ".join(
        f"{share:.2g} with h{f'/{number}' if number > 1 else ''}"
        for number, share in shares.items()
    )
    where = f"{len(compared.names)} values over {length - 1} steps of h = {subject.step:g} s, {events} events; largest difference {shown} of the value's size"
    if jumps.any():
        where += f", but for {int(jumps.sum())} that jump within the error of an event's time"
    if unexplained.any():
        row, column = np.argwhere(unexplained)[0]
        return failed(
            f"{compared.names[column]} differs at t = {subject.time(row):.6g} s: {finest[row, column]:.8g} by Co-Simulation, "
            f"{truth[row, column]:.8g} by Model Exchange, more than steps and tolerances explain ({allowed[row, column]:.1g}); {where}."
        )
    if max(shares[max(shares)], float(jumps.mean())) <= _COMPARED:
        return passed(f"{where}{why}.")
    return not_offered(
        f"{where}{why or ': steps and tolerances may explain it, which tells nothing'}."
    )


def _running(rows: np.ndarray) -> np.ndarray:
    """The largest so far, and a step later: an error that was there may come back, and what happens at an event may come a step later."""
    largest = np.maximum.accumulate(np.where(np.isfinite(rows), rows, np.inf), axis=0)
    return np.vstack([largest[1:], largest[-1:]])


class _Event(NamedTuple):
    """A state event: its time [s]; delay (nx,), how much later it comes for each unit of a state's error [s per unit]; and which values (compared,) jump."""

    time: float
    delay: np.ndarray
    jumps: np.ndarray


@dataclass(frozen=True, eq=False)
class _Events:
    """State events of Model Exchange, and what their uncertain times explain.

    truth (rows, compared): values of Model Exchange; tolerated (compared,): by the FMU's tolerance
        [unit of each]; columns (nx,): where each state is among them, -1 where it is not; usual
        (nx,): errors of such states, by the tolerance [unit of each].
    """

    step: float
    start: float
    events: tuple[_Event, ...]
    truth: np.ndarray
    tolerated: np.ndarray
    columns: np.ndarray
    usual: np.ndarray

    @classmethod
    def of(
        cls, subject: Subject, compared: Block, truth: np.ndarray, tolerated: np.ndarray
    ) -> _Events:
        """Integrate once more, and look at each event. Raises as `_integrated`."""
        places = dict(zip((item.key for item in compared), compared.ends.tolist(), strict=False))
        columns = np.concatenate(
            [
                np.empty(0, dtype=int),
                *(
                    places[item.key] + np.arange(item.size)
                    if item.key in places
                    else np.full(item.size, -1)
                    for item in subject.states
                ),
            ]
        )
        made: list[_Watched] = []

        def watch(*given: Any) -> Exchange:
            made.append(_Watched(compared, *given))
            return made[-1]

        steps = len(truth) - 1
        by_adams_or_bdf(
            lambda method: _integrated(subject, compared, steps, _RTOLS[1], method, watch)
        )
        mover = made[-1]
        if len(columns) != mover.count:  # the description does not list its states
            columns = np.full(mover.count, -1)
        usual = max(subject.tolerance, _FINEST) * mover.largest
        return cls(
            subject.step, subject.start_time, tuple(mover.noted), truth, tolerated, columns, usual
        )

    def allowed(self, differences: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """What some errors (rows, compared) explain [unit of each], as they were measured.

        Returns
        -------
        (rows, compared) how far values may be apart [unit of each]; and whether a value jumps within
        the error of an event's time, so that it is not compared.

        Raises
        ------
        Nothing.
        """
        times = self.start + self.step * np.arange(len(self.truth))
        shown = [self._without_jumps(item) for item in differences]
        allowed = self.tolerated + SAFETY * sum(map(_running, shown), np.zeros(self.truth.shape))
        jumps, later = np.zeros(self.truth.shape, dtype=bool), np.zeros(self.truth.shape)
        for event in self.events:
            row = self._step_of(event)
            spread = self._spread(event, allowed[row])
            # Where the methods that were measured make it jump at another point than the truth, they
            # find it at the end of a step.
            at = slice(row, row + 3)
            late = np.any([(item[at] > self.tolerated).any(axis=0) for item in differences], axis=0)
            near = np.abs(times - event.time)[:, np.newaxis] <= spread + self.step * late
            jumps |= near & event.jumps
            # What an error that was measured does to the motion after the event was measured too.
            spread = self._spread(event, self.tolerated)
            bend = self._bend(row)
            later[times >= event.time - spread] += np.where(bend > 0.0, bend * spread, 0.0)
        return allowed + later, jumps

    def _spread(self, event: _Event, errors: np.ndarray) -> float:
        """How far the time of an event may be off [s], by errors of the values (compared,) [unit of each]."""
        error = np.where(self.columns < 0, self.usual, errors[self.columns])
        return float(np.sum(event.delay * error, where=event.delay > 0.0))

    def _step_of(self, event: _Event) -> int:
        """The step in which an event is, or at whose begin."""
        return int((event.time - self.start) / self.step)

    def _without_jumps(self, difference: np.ndarray) -> np.ndarray:
        """An error that was measured, without what jumps at the points about its event."""
        found = difference.copy()
        for event in self.events:
            row = self._step_of(event)
            found[row : row + 3, event.jumps] = 0.0
        return found

    def _bend(self, step: int) -> np.ndarray:
        """By how much slopes (compared,) change at the events of a step [unit of each per s]: those of the steps before and after it that have none."""
        busy = {self._step_of(event) for event in self.events}
        slopes = np.diff(self.truth, axis=0) / self.step
        before = next((place for place in range(step - 1, -1, -1) if place not in busy), None)
        after = next((place for place in range(step + 1, len(slopes)) if place not in busy), None)
        if before is None or after is None:
            return np.zeros(self.truth.shape[1])
        return np.abs(slopes[after] - slopes[before])


# The slope of an event indicator is taken over this share of a communication step.
_SLOPE_SHARE = 1e-3
# Evaluations for the slopes of event indicators in all. The time of an event beyond that is unknown.
_MOST_EVALUATIONS = 200_000


class _Watched(Exchange):
    """CVODE that notes of each state event how uncertain its time is.

    noted: the events; largest (nx,): sizes of the states [unit of each].
    """

    def __init__(
        self, compared: Block, instance: CheckedInstance, rtol: float, method: tuple[int, int]
    ) -> None:
        super().__init__(instance, rtol, method)
        self._compared, self.noted = compared, list[_Event]()
        self.largest = 1e-3 * self.nominal[: self.count]
        self._left = _MOST_EVALUATIONS

    def _event(self, crossed: tuple[int, ...]) -> None:
        if not crossed:
            super()._event(crossed)
            return
        time, delay = self.time, self._delay(list(crossed))
        before = self.instance.get(self._compared)
        super()._event(crossed)
        after = self.instance.get(self._compared)
        size = np.maximum(np.maximum(np.abs(before), np.abs(after)), self._compared.scales)
        self.noted.append(_Event(time, delay, np.abs(after - before) > JUMP * size))

    def _delay(self, crossed: list[int]) -> np.ndarray:
        """How much later the event comes for each unit of a state's error (nx,) [s per unit]: slopes of its indicators by that state over those in time."""
        instance, time, x = self.instance, self.time, self.y[: self.count].copy()
        self.largest = np.maximum(self.largest, np.abs(x))
        self._left -= len(x)
        if self._left < 0:
            return np.full(len(x), np.inf)

        def indicators(at: float, states: np.ndarray) -> np.ndarray:
            """Crossed indicators (crossed,) [-] at states (states,) [unit of each]. Raises FmuError."""
            instance.move(at, states)
            return instance.indicators()[crossed]

        length = _SLOPE_SHARE * instance.subject.step
        here, rates = indicators(time, x), instance.rates()
        slope = np.abs(here - indicators(time - length, x - length * rates)) / length
        found = np.zeros(len(x))
        step = max(instance.subject.tolerance, _FINEST) * self.largest
        for place in range(len(x)):
            moved = x.copy()
            moved[place] += step[place]
            off = np.abs(indicators(time, moved) - here) / step[place]
            with np.errstate(divide="ignore", invalid="ignore"):
                found[place] = np.max(np.where(off > 0.0, off / slope, 0.0))
        instance.move(time, x)
        return found


def _begun(subject: Subject, kind: str, name: str) -> CheckedInstance:
    """An instance that begins with the first inputs."""
    return CheckedInstance(subject, kind, name).begin(
        during=(subject.continuous_inputs, subject.inputs_at(0))
    )


def _integrated(
    subject: Subject,
    compared: Block,
    steps: int,
    rtol: float,
    method: tuple[int, int],
    make: Callable[..., Exchange] = Exchange,
) -> tuple[np.ndarray, int]:
    """Values by CVODE, and how many state events there were; shorter if events crowd."""
    with _begun(subject, "ME", "reference") as instance:
        mover = make(instance, rtol, method)
        mover.renew(subject.start_time)
        rows = [instance.get(compared)]
        for step in range(steps):
            if step and step % HOLD == 0 and subject.continuous_inputs:
                mover.jump(subject.time(step), subject.inputs_at(step))
            try:
                mover.advance(subject.time(step + 1))
            except Crowded:
                break
            rows.append(instance.get(compared))
        return np.array(rows), sum(bool(event[1]) for event in mover.record.events)


def _cosimulation(
    subject: Subject, compared: Block, steps: int, parts: int
) -> tuple[np.ndarray, int]:
    """Values after each step, and in how many of its parts (at most, over all steps) they moved."""
    with _begun(subject, "CS", f"parts {parts}") as instance:
        rows = [instance.get(compared)]
        length = subject.step / parts
        awake = 1
        for step in range(steps):
            if step and step % HOLD == 0:
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
            moved, before = 0, rows[-1]
            for part in range(parts):
                instance.do_step(subject.time(step) + part * length, length)
                after = instance.get(compared)
                moved += not np.array_equal(before, after)
                before = after
            awake = max(awake, moved)
            rows.append(before)
        return np.array(rows), awake


def _euler(subject: Subject, compared: Block, steps: int, parts: int) -> np.ndarray | None:
    """Explicit Euler with a part of the communication step, events looked for at its ends.

    None if it diverges into errors.
    """
    length = subject.step / parts
    with _begun(subject, "ME", "euler") as instance:
        rows = [instance.get(compared)]
        for step in range(steps):
            if step and step % HOLD == 0 and subject.continuous_inputs:
                instance.fmu.enterEventMode()
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
                instance.settle()
            try:
                for part in range(1, parts + 1):
                    x = (
                        instance.states() + length * instance.rates()
                        if instance.state_count
                        else np.empty(0)
                    )
                    instance.move(subject.time(step) + part * length, x)
                    instance.event()
                rows.append(instance.get(compared))
            except (FMICallException, Misbehaviour):
                return None
        return np.array(rows)
