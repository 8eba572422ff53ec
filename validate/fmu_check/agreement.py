"""Model Exchange against Co-Simulation: the same motion, up to errors of step and tolerance.

Model Exchange is integrated by CVODE with two tolerances, Co-Simulation runs with the steps of a
ladder (validate.fmi.ladder), all with the same piecewise constant inputs. A difference is explained
by the spread of either, or by the FMU's tolerance. The time of a state event is as uncertain as the
states over the slope of its indicator, so values that jump there are compared outside that time.
Co-Simulation that ignores the communication step has an error that no step shows: it may be as large
as that of explicit Euler, the plainest integrator, on the same equations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.cvode import ADAMS
from validate.fmi.instance import Misbehaviour, RefusedCall
from validate.fmi.ladder import FINEST, LADDER
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.motion import JUMP, SAFETY, Exchange, by_adams_or_bdf, run
from validate.fmu_check.subject import Block, CheckedInstance, Subject

# Relative tolerances of CVODE; their difference is the error bar of the tighter run.
_RTOLS = (1e-7, 1e-9)
# Least tolerance of the comparison, as a share of a value's size: ten times that of the looser run.
_FINEST = 1e-6
# The check is not decisive if errors explain a larger share of the value's size than this, or if more
# values than this share are left out.
_COMPARED = 0.1
# Number of values above which only every second, third .. is compared.
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
    steps = min(subject.long_steps(kind) for kind in subject.types)
    compared = Block(compared[:: max(1, len(compared) // _MOST_COMPARED)])
    subject = subject.observing(compared)
    fine, mover = by_adams_or_bdf(partial(_integrated, subject, steps, _RTOLS[1]))
    coarse, _ = by_adams_or_bdf(partial(_integrated, subject, len(fine) - 1, _RTOLS[0]))
    length = min(len(fine), len(coarse))
    truth, events = fine[:length], sum(bool(event[1]) for event in mover.record.events)
    is_free = subject.can("CS", "canHandleVariableCommunicationStepSize")
    results: dict[int, np.ndarray] = {}
    smallest = 1
    for part in LADDER[:FINEST] if is_free else LADDER[:1]:
        try:
            with _Parted(subject, part).begin() as instance:
                results[part] = run(instance, 0, length - 1)
            smallest = instance.most
        except RefusedCall:
            # A refinement is our choice: an FMU may take multiples of its own step alone.
            if not results:
                raise
    finest = results[max(results)]
    size = np.maximum(np.abs(truth).max(axis=0), 1e-3 * compared.scales)
    errors = [np.ptp([*results.values()], axis=0), np.abs(truth - coarse[:length])]
    explained = _Explained(subject, truth, max(subject.tolerance, _FINEST) * size)
    left, allowed, jumps = explained.differences(finest, errors)
    if events and left.any():
        make = partial(_integrated, subject, length - 1, _RTOLS[1], make=_Watched)
        explained.events = by_adams_or_bdf(make)[1].noted
        left, allowed, jumps = explained.differences(finest, errors)
    why = ""
    if left.any() and (euler := _euler(subject, length - 1, smallest)) is not None:
        errors.append(SAFETY * np.abs(euler - truth))
        left, allowed, jumps = explained.differences(finest, errors)
        why = (
            ": no more than explicit Euler has with the smallest of these steps, but it does not "
            "shrink with the step"
        )
    shares = {
        part: float((np.abs(rows - truth) / size).max(where=~jumps, initial=0.0))
        for part, rows in results.items()
    }
    shown = ", ".join(
        f"{share:.2g} with h{f'/{part}' if part > 1 else ''}" for part, share in shares.items()
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
            f"{finest[row, column]:.8g} by Co-Simulation, {truth[row, column]:.8g} by Model "
            f"Exchange, more than steps and tolerances explain ({allowed[row, column]:.1g}); "
            f"{where}."
        )
    if max(shares[max(shares)], float(jumps.mean())) <= _COMPARED:
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

    time, spread: when it comes, and how uncertain that is by tolerated errors of the states [s].
    jumps: (compared,) whether a value jumps.
    """

    time: float
    spread: float
    jumps: np.ndarray


@dataclass(eq=False)
class _Explained:
    """Differences that errors of steps, tolerances and event times explain.

    truth: (rows, compared) values of Model Exchange [unit of each].
    tolerated: (compared,) by the FMU's tolerance [unit of each].
    """

    subject: Subject
    truth: np.ndarray
    tolerated: np.ndarray
    events: Sequence[_Event] = ()

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
            each]; whether the value jumps. A value jumps if it changes within the error of an
            event's time; it is not compared.

        Raises
        ------
        Nothing.
        """
        allowed = self.tolerated + sum(_running(self._without_jumps(item)) for item in errors)
        step = self.subject.step
        times = self.subject.start_time + step * np.arange(len(self.truth))
        jumps = np.zeros(self.truth.shape, dtype=bool)
        for event in self.events:
            row = self._row(event)
            # Runs that jump at another point than the truth find the event at the end of a step.
            rows = slice(row, row + 3)
            late = np.any([(item[rows] > self.tolerated).any(axis=0) for item in errors], axis=0)
            near = np.abs(times - event.time)[:, None] <= event.spread + step * late
            jumps |= near & event.jumps
            # The motion after the event is late by its spread.
            bend = self._bend(row)
            allowed[times >= event.time - event.spread] += np.where(
                bend > 0.0, bend * event.spread, 0.0
            )
        return ~(np.abs(values - self.truth) <= allowed) & ~jumps, allowed, jumps

    def _row(self, event: _Event) -> int:
        """Return the row before an event."""
        return int((event.time - self.subject.start_time) / self.subject.step)

    def _without_jumps(self, error: np.ndarray) -> np.ndarray:
        """Return an error (rows, compared) [unit of each] without jumps at rows about events."""
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
    """CVODE that notes how uncertain the time of each state event is."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.noted: list[_Event] = []
        self._largest = 1e-3 * self.nominal[: self.count]
        self._left = _MOST_EVALUATIONS

    def _event(self, crossed: tuple[int, ...]) -> None:
        if not crossed:
            super()._event(crossed)
            return
        time, spread, before = self.time, self._spread(list(crossed)), self.instance.observe()
        super()._event(crossed)
        after, scales = self.instance.observe(), self.instance.subject.observed.scales
        size = np.maximum(np.maximum(np.abs(before), np.abs(after)), scales)
        self.noted.append(_Event(time, spread, np.abs(after - before) > JUMP * size))

    def _spread(self, crossed: list[int]) -> float:
        """Return the error of the event's time [s] by tolerated errors of the states.

        It is the change of the crossed indicators by these errors over their slope in time. Raises
        FMICallException.
        """
        instance, time, x = self.instance, self.time, self.y[: self.count].copy()
        self._largest = np.maximum(self._largest, np.abs(x))
        self._left -= len(x)
        if self._left < 0:
            return np.inf

        def indicators(at: float, states: np.ndarray) -> np.ndarray:
            """Crossed indicators (crossed,) [-] at states (nx,) [unit of each]. Raises as above."""
            instance.move(at, states)
            return instance.indicators()[crossed]

        length = _SLOPE_SHARE * instance.subject.step
        here, rates = indicators(time, x), instance.rates()
        slope = np.abs(here - indicators(time - length, x - length * rates)) / length
        spread = 0.0
        for row in np.diag(max(instance.subject.tolerance, _FINEST) * self._largest):
            off = np.abs(indicators(time, x + row) - here)
            with np.errstate(divide="ignore", invalid="ignore"):
                spread += np.max(np.where(off > 0.0, off / slope, 0.0))
        instance.move(time, x)
        return float(spread)


class _Euler(Exchange):
    """Explicit Euler with a part of the communication step, and events at the ends of its steps."""

    def __init__(self, parts: int, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._parts = parts

    def renew(self, time: float) -> None:
        """Continue at `time` [s]."""
        self.time = time

    def advance(self, target: float) -> None:
        """Integrate to `target` [s]."""
        instance, begin, length = self.instance, self.time, (target - self.time) / self._parts
        for part in range(1, self._parts + 1):
            instance.move(begin + part * length, instance.states() + length * instance.rates())
            instance.event()
        self.time = target


class _Parted(CheckedInstance):
    """A Co-Simulation instance that makes each communication step in parts.

    most: in how many parts of a step its values moved, at most.
    """

    most = 1

    def __init__(self, subject: Subject, parts: int) -> None:
        super().__init__(subject, "CS", f"parts {parts}")
        self._parts = parts

    def make_step(self, step: int) -> None:
        """Make one communication step of the subject's grid. Raises FMICallException, Fault."""
        length, before, moved = self.subject.step / self._parts, self.observe(), 0
        for part in range(self._parts):
            self.time = self.subject.time(step) + part * length
            self.do_step(self.time, length)
            after = self.observe()
            moved += not np.array_equal(before, after)
            before = after
        self.most = max(self.most, moved)


def _integrated(
    subject: Subject,
    steps: int,
    rtol: float,
    method: tuple[int, int],
    make: Callable[..., Any] = Exchange,
) -> tuple[np.ndarray, Any]:
    """Return the values (rows, compared) of Model Exchange [unit of each] and the integration.

    Rows end where events crowd. Raises as `run`.
    """
    with CheckedInstance(subject, "ME", "reference").begin() as instance:
        mover = make(instance, rtol, method)
        return run(instance, 0, steps, mover=mover), mover


def _euler(subject: Subject, steps: int, parts: int) -> np.ndarray | None:
    """Return the values (rows, compared) by explicit Euler [unit of each]; None if it fails."""
    try:
        return _integrated(subject, steps, _RTOLS[0], ADAMS, partial(_Euler, parts))[0]
    except (FMICallException, Misbehaviour):
        return None
