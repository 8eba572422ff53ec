"""Model Exchange against Co-Simulation: the same motion, up to errors of step and tolerance.

Model Exchange is integrated by CVODE with two tolerances, Co-Simulation runs with the steps of a
ladder (validate.fmi.ladder), all with the same piecewise constant inputs. A difference is explained
by the spread of either, or by the FMU's tolerance. The time of a state event is as uncertain as the
states over the slope of its indicator, so values that jump there are compared outside that time.
Co-Simulation that ignores the communication step has an error that no step shows: it may be as large
as that of explicit Euler, the plainest integrator, on the same equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Misbehaviour
from validate.fmi.ladder import FINEST, LADDER
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.motion import JUMP, SAFETY, Crowded, Exchange, by_adams_or_bdf
from validate.fmu_check.subject import HOLD, Block, CheckedInstance, Subject

# Relative tolerances of CVODE; their difference is the error bar of the tighter run.
_RTOLS = (1e-7, 1e-9)
# Least tolerance of the comparison, as a share of a value's size: ten times that of the looser run.
_FINEST = 1e-6
# The check tells nothing if errors explain a larger share of the value's size than this, or if more
# values than this share are left out.
_COMPARED = 0.1
# Of more values than twice this number every second, third .. is compared.
_MOST_COMPARED = 10_000


@check("Model Exchange equals Co-Simulation", Scope.FILE)
def agree(subject: Subject) -> Finding:
    """Both move alike as the step shrinks, or within the FMU's tolerance."""
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
    fine, mover = by_adams_or_bdf(partial(_integrated, subject, compared, steps, _RTOLS[1]))
    coarse, _ = by_adams_or_bdf(partial(_integrated, subject, compared, len(fine) - 1, _RTOLS[0]))
    length = min(len(fine), len(coarse))
    truth, events = fine[:length], sum(bool(event[1]) for event in mover.record.events)
    is_free = subject.can("CS", "canHandleVariableCommunicationStepSize")
    parts = LADDER[:FINEST] if is_free else LADDER[:1]
    runs = [_cosimulation(subject, compared, length - 1, part) for part in parts]
    results = [rows for rows, _ in runs]
    size = np.maximum(np.abs(truth).max(axis=0), 1e-3 * compared.scales)
    errors = [np.ptp(results, axis=0), np.abs(truth - coarse[:length])]
    explained = _Explained(subject, truth, max(subject.tolerance, _FINEST) * size)
    left, allowed, jumps = explained.differences(results[-1], errors)
    if events and left.any():
        explained = explained.with_events(compared)
        left, allowed, jumps = explained.differences(results[-1], errors)
    why, smallest = "", runs[-1][1]
    if left.any() and (euler := _euler(subject, compared, length - 1, smallest)) is not None:
        errors.append(SAFETY * np.abs(euler - truth))
        left, allowed, jumps = explained.differences(results[-1], errors)
        why = (
            ": no more than the error of explicit Euler with the smallest of these steps, but it "
            "does not shrink with the step"
        )
    shares = [
        float((np.abs(rows - truth) / size).max(where=~jumps, initial=0.0)) for rows in results
    ]
    shown = ", ".join(
        f"{share:.2g} with h{f'/{part}' if part > 1 else ''}"
        for part, share in zip(parts, shares, strict=True)
    )
    where = (
        f"{compared.entries} values over {length - 1} steps of h = {subject.step:g} s, {events} "
        f"events; largest difference {shown} of the value's size"
    )
    if jumps.any():
        where += f", but for {int(jumps.sum())} that jump within the error of an event's time"
    if left.any():
        row, column = np.argwhere(left)[0]
        return failed(
            f"{compared.names[column]} differs at t = {subject.time(row):.6g} s: "
            f"{results[-1][row, column]:.8g} by Co-Simulation, {truth[row, column]:.8g} by Model "
            f"Exchange, more than steps and tolerances explain ({allowed[row, column]:.1g}); "
            f"{where}."
        )
    if max(shares[-1], float(jumps.mean())) <= _COMPARED:
        return passed(f"{where}{why}.")
    return not_offered(f"{where}{why}: that is too much to tell whether they agree.")


def _running(rows: np.ndarray) -> np.ndarray:
    """Return the largest error (rows, compared) so far and one step later [unit of each].

    An error may come back, and an event may come a step later. Raises nothing.
    """
    largest = np.maximum.accumulate(np.where(np.isfinite(rows), rows, np.inf), axis=0)
    return np.vstack([largest[1:], largest[-1:]])


class _Event(NamedTuple):
    """A state event.

    time: [s].
    delay: (nx,) how much later it comes per unit of a state's error [s per unit].
    jumps: (compared,) whether a value jumps.
    """

    time: float
    delay: np.ndarray
    jumps: np.ndarray


@dataclass(frozen=True, eq=False)
class _Explained:
    """Differences that errors of steps, tolerances and event times explain.

    truth: (rows, compared) values of Model Exchange [unit of each].
    tolerated: (compared,) by the FMU's tolerance [unit of each].
    columns: (nx,) the column of each state, -1 if it is not compared.
    usual: (nx,) tolerated errors of the states [unit of each].
    """

    subject: Subject
    truth: np.ndarray
    tolerated: np.ndarray
    events: tuple[_Event, ...] = ()
    columns: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    usual: np.ndarray = field(default_factory=lambda: np.empty(0))

    def with_events(self, compared: Block) -> _Explained:
        """Integrate again and measure each event. Raises as `_integrated`."""
        subject, steps = self.subject, len(self.truth) - 1
        make = partial(_Watched, compared)
        simulate = partial(_integrated, subject, compared, steps, _RTOLS[1], make=make)
        _, mover = by_adams_or_bdf(simulate)
        places = {item.key: place for item, place in zip(compared, compared.ends, strict=False)}
        columns = [
            places[item.key] + entry if item.key in places else -1
            for item in subject.states
            for entry in range(item.size)
        ]
        if len(columns) != mover.count:  # the description does not list its states
            columns = [-1] * mover.count
        usual = max(subject.tolerance, _FINEST) * mover.largest
        return _Explained(
            subject,
            self.truth,
            self.tolerated,
            tuple(mover.noted),
            np.array(columns, dtype=int),
            usual,
        )

    def differences(
        self, values: np.ndarray, errors: list[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compare Co-Simulation with Model Exchange.

        Parameters
        ----------
        values
            (rows, compared) of Co-Simulation [unit of each].
        errors
            Each (rows, compared): error bars of either [unit of each].

        Returns
        -------
        tuple of np.ndarray
            Each (rows, compared): whether a difference is unexplained; how large it may be [unit of
            each]; whether the value jumps within the error of an event's time, so that it is not
            compared.

        Raises
        ------
        Nothing.
        """
        allowed = self.tolerated + sum(_running(self._without_jumps(item)) for item in errors)
        times = self.subject.start_time + self.subject.step * np.arange(len(self.truth))
        jumps, later = np.zeros(self.truth.shape, dtype=bool), np.zeros(self.truth.shape)
        for event in self.events:
            row = self._row(event)
            spread = self._spread(event, allowed[row])
            # Runs that jump at another point than the truth find the event at the end of a step.
            rows = slice(row, row + 3)
            late = np.any([(item[rows] > self.tolerated).any(axis=0) for item in errors], axis=0)
            near = np.abs(times - event.time)[:, None] <= spread + self.subject.step * late
            jumps |= near & event.jumps
            # The runs show how measured errors change the motion after the event; tolerated ones
            # make it late by their spread.
            spread = self._spread(event, self.tolerated)
            bend = self._bend(row)
            later[times >= event.time - spread] += np.where(bend > 0.0, bend * spread, 0.0)
        allowed = allowed + later
        return ~(np.abs(values - self.truth) <= allowed) & ~jumps, allowed, jumps

    def _spread(self, event: _Event, errors: np.ndarray) -> float:
        """Return the error of an event's time [s] from errors of values (compared,) [unit of each]."""
        error = np.where(self.columns < 0, self.usual, errors[self.columns])
        return float(np.sum(event.delay * error, where=event.delay > 0.0))

    def _row(self, event: _Event) -> int:
        """Return the row before an event."""
        return int((event.time - self.subject.start_time) / self.subject.step)

    def _without_jumps(self, error: np.ndarray) -> np.ndarray:
        """Return an error (rows, compared) [unit of each] without jumps at the rows about events."""
        found = error.copy()
        for event in self.events:
            row = self._row(event)
            found[row : row + 3, event.jumps] = 0.0
        return found

    def _bend(self, row: int) -> np.ndarray:
        """Return the change of slope (compared,) at the events after a row [unit of each per s].

        The slopes are those of the nearest steps without an event. Raises nothing.
        """
        slopes = np.diff(self.truth, axis=0) / self.subject.step
        busy = [self._row(event) for event in self.events]
        quiet = np.setdiff1d(np.arange(len(slopes)), busy)
        before, after = quiet[quiet < row], quiet[quiet > row]
        if not before.size or not after.size:
            return np.zeros(self.truth.shape[1])
        return np.abs(slopes[after[0]] - slopes[before[-1]])


# The slope of an event indicator is taken over this share of a communication step: short against the
# motion, long against rounding.
_SLOPE_SHARE = 1e-3
# Evaluations for the slopes of event indicators, about 2 s. The time of later events is unknown.
_MOST_EVALUATIONS = 200_000


class _Watched(Exchange):
    """CVODE that notes how uncertain the time of each state event is.

    noted: the events.
    largest: (nx,) sizes of the states [unit of each].
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
        """Return the delay (nx,) of the event per unit of a state's error [s per unit].

        It is the slope of the crossed indicators by that state over their slope in time. Raises
        FMICallException.
        """
        instance, time, x = self.instance, self.time, self.y[: self.count].copy()
        self.largest = np.maximum(self.largest, np.abs(x))
        self._left -= len(x)
        if self._left < 0:
            return np.full(len(x), np.inf)

        def indicators(at: float, states: np.ndarray) -> np.ndarray:
            """Crossed indicators (crossed,) [-] at states (nx,) [unit of each]. Raises as above."""
            instance.move(at, states)
            return instance.indicators()[crossed]

        length = _SLOPE_SHARE * instance.subject.step
        here, rates = indicators(time, x), instance.rates()
        slope = np.abs(here - indicators(time - length, x - length * rates)) / length
        delay = np.zeros(len(x))
        for place, step in enumerate(max(instance.subject.tolerance, _FINEST) * self.largest):
            moved = x.copy()
            moved[place] += step
            off = np.abs(indicators(time, moved) - here) / step
            with np.errstate(divide="ignore", invalid="ignore"):
                delay[place] = np.max(np.where(off > 0.0, off / slope, 0.0))
        instance.move(time, x)
        return delay


def _begun(subject: Subject, kind: str, name: str) -> CheckedInstance:
    """Initialise an instance with the first inputs."""
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
) -> tuple[np.ndarray, Exchange]:
    """Return the values after each step by CVODE, fewer if events crowd, and the integration."""
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
        return np.array(rows), mover


def _cosimulation(
    subject: Subject, compared: Block, steps: int, parts: int
) -> tuple[np.ndarray, int]:
    """Return the values after each step, and in how many parts of a step they moved at most."""
    with _begun(subject, "CS", f"parts {parts}") as instance:
        rows = [instance.get(compared)]
        length = subject.step / parts
        most = 1
        for step in range(steps):
            if step and step % HOLD == 0:
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
            moved, before = 0, rows[-1]
            for part in range(parts):
                instance.do_step(subject.time(step) + part * length, length)
                after = instance.get(compared)
                moved += not np.array_equal(before, after)
                before = after
            most = max(most, moved)
            rows.append(before)
        return np.array(rows), most


def _euler(subject: Subject, compared: Block, steps: int, parts: int) -> np.ndarray | None:
    """Return the values by explicit Euler, with events at the ends of its steps; None if it fails."""
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
                    x = instance.states() + length * instance.rates()
                    instance.move(subject.time(step) + part * length, x)
                    instance.event()
                rows.append(instance.get(compared))
            except (FMICallException, Misbehaviour):
                return None
        return np.array(rows)
