"""Runs of an instance and their comparison.

    rows = fresh_run(subject, "ME", steps)
    require_equal(subject, rows, fresh_run(subject, "ME", steps), "in a second run")

Co-Simulation makes communication steps; Model Exchange is integrated by CVODE, with located events.
A run is a function of the instance's state, the steps and the inputs: two runs from equal states
must give equal bits.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from validate.fmi.cvode import ADAMS, BDF, FILLS, ROOT_RETURN, Cvode, array_of, why
from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Failed
from validate.fmu_check.subject import HOLD, CheckedInstance, Subject

# Largest difference of runs that should be equal, as a share of a variable's size, if an FMU's own
# integrator restarts and declares a looser tolerance.
_RESTART = 1e-6


def compare(
    subject: Subject, one: np.ndarray, other: np.ndarray, first: int = 0
) -> tuple[float, str]:
    """Return the difference of two runs.

    Parameters
    ----------
    subject
        The FMU, whose variables are compared.
    one, other
        (rows, observed) values of all variables [unit of each variable].
    first
        The step of row 0.

    Returns
    -------
    tuple of float and str
        The largest difference as a share of the variable's size [-], and a clause with variable,
        difference and time. The difference is infinite for runs of different length; the clause is
        empty if all bits are equal.

    Raises
    ------
    ValueError
        If the columns are not the observed variables.
    """
    if len(one) != len(other):
        end = subject.time(first + min(len(one), len(other)))
        lengths = f"{len(one)} against {len(other)} steps"
        return np.inf, f"the length of the run ({lengths}) differs by inf at t = {end:.6g} s"
    if np.array_equal(one, other, equal_nan=True):
        return 0.0, ""
    with np.errstate(invalid="ignore"):
        apart = np.abs(one - other)
    apart[(one == other) | (np.isnan(one) & np.isnan(other))] = 0.0
    apart[~np.isfinite(apart)] = np.inf
    size = np.abs(one).max(axis=0, where=np.isfinite(one), initial=0.0)
    shares = apart / np.maximum(size, 1e-6 * subject.observed.scales)
    row, column = np.unravel_index(int(np.argmax(shares)), shares.shape)
    name, time = subject.observed.names[column], subject.time(first + int(row))
    where = f"{name} differs by {apart[row, column]:.2g} at t = {time:.6g} s"
    return float(shares[row, column]), where


def require_equal(
    subject: Subject, one: np.ndarray, other: np.ndarray, clause: str, first: int = 0
) -> None:
    """Raise Failed if two runs differ in any bit.

    Parameters
    ----------
    one, other
        (rows, observed) values of all variables [unit of each variable].
    clause
        How the second run was made.
    first
        The step of row 0.

    Raises
    ------
    Failed
        With the clause, the variable and the time.
    """
    _, where = compare(subject, one, other, first)
    if where:
        raise Failed(f"{clause}, {where}.")


def fresh_run(
    subject: Subject, kind: str, steps: int, name: str = "check", **how: Any
) -> np.ndarray:
    """Run a fresh instance from its start; how: see `run`.

    Returns
    -------
    np.ndarray
        (steps + 1, observed) values of all variables [unit of each variable].

    Raises
    ------
    FMICallException, Fault
        As `run`.
    """
    with CheckedInstance(subject, kind, name) as instance:
        return run(instance.begin(), 0, steps, **how)


def restart_limit(subject: Subject) -> float:
    """Return how far a continued run may be from the first one, as a share of a variable's size."""
    return min(subject.tolerance, _RESTART)


# Errors of solvers of one order, or with one tolerance, differ by such a factor.
SAFETY = 4.0
# Relative tolerance of runs that are compared with each other only.
TOLERANCE = 1e-6
# Internal steps to the next communication point before the integrator gives up.
_STEP_LIMIT = 200_000
# A run ends after this many events ...
_MOST_EVENTS = 2000
# ... or if 20 events follow each other within this share of a step each, as those of a ball that
# comes to rest.
_CROWDED = 1e-7
# A value jumps at an event if it changes by more than this share of its size: a hundred times the
# error with which CVODE locates the event.
JUMP = 1e-8
# Shortest time to integrate over, as a share of the time (of 1 s near 0): 450 units in the last
# place of 1. The longest run has 500 steps. A time that an FMU sums up from 500 periods is up to
# 250 units off.
_NO_TIME = 1e-13


@dataclass
class Record:
    """Notes about a run of Model Exchange.

    - events: time, indicators that crossed, values of all indicators.
    - surprises: clauses about jumps at events that nothing announced.
    - unreported: clauses about states that an event changed without reporting it.
    - crowded: time from which events crowd [s].
    """

    events: list[tuple[float, tuple[int, ...], np.ndarray]] = field(default_factory=list)
    surprises: list[str] = field(default_factory=list)
    unreported: list[str] = field(default_factory=list)
    crowded: float = math.inf


def _still(rates: Any, _size: int) -> None:
    """Compute the derivative of the constant state that stands in for missing states."""
    rates[0] = 0.0


class Crowded(Exception):  # noqa: N818 - ends a run
    """Events follow each other without end."""


def run(
    instance: CheckedInstance,
    first: int,
    last: int,
    *,
    seed: int = 0,
    after: Callable[[int], Any] | None = None,
    observe: Literal["each", "end"] = "each",
    record: Record | None = None,
    mover: Exchange | None = None,
) -> np.ndarray:
    """Make communication steps first..last, with moving inputs.

    Parameters
    ----------
    instance
        In Continuous-Time Mode, or before a step.
    first, last
        Steps of the subject's grid.
    seed
        Number of the inputs' signal.
    after
        Called as after(step) after each step.
    observe
        Times of stored values: after each step, or only at the end.
    record
        Notes about events of Model Exchange.
    mover
        The integration of Model Exchange; None: CVODE with TOLERANCE.

    Returns
    -------
    np.ndarray
        (last - first + 1, observed) values of all variables [unit of each variable], at the
        beginning and after each step; (1, observed) at the end.

    Raises
    ------
    FMICallException, Fault
        If the FMU refuses a call, misbehaves or ends.
    """
    subject = instance.subject
    rows = [instance.observe()] if observe == "each" else []
    if instance.kind == "ME":
        mover = mover or Exchange(instance, TOLERANCE, record=record)
    closing = contextlib.closing(mover) if mover else contextlib.nullcontext()
    with closing, contextlib.suppress(Crowded):
        for step in range(first, last):
            if step == first or step % HOLD == 0:
                inputs = subject.inputs_at(step, seed)
                if mover is None:
                    instance.set(subject.continuous_inputs, inputs)
                else:
                    mover.jump(subject.time(step), inputs)
            if mover is None:
                instance.make_step(step)
            else:
                mover.advance(subject.time(step + 1))
            if observe == "each":
                rows.append(instance.observe())
            if after is not None:
                after(step)
    return np.array(rows) if observe == "each" else instance.observe()[np.newaxis]


def by_adams_or_bdf(simulate: Callable[[tuple[int, int]], Any]) -> Any:
    """Return simulate(method) with Adams' method of CVODE, or with BDF if Adams fails.

    Raises Misbehaviour.
    """
    try:
        return simulate(ADAMS)
    except Misbehaviour:
        return simulate(BDF)


class Exchange:
    """An integration by CVODE of an instance in Continuous-Time Mode."""

    def __init__(
        self,
        instance: CheckedInstance,
        rtol: float,
        method: tuple[int, int] = BDF,
        *,
        record: Record | None = None,
    ) -> None:
        self.instance, self.record = instance, record or Record()
        self.problem: Exception | None = None
        self.count, indicators = instance.state_count, instance.indicator_count
        # An FMU without continuous states still has time and events: with a constant state CVODE
        # locates them.
        self.nominal = np.abs(instance.nominals()) if self.count else np.ones(1)
        self.nominal[~(self.nominal > 0.0)] = 1.0
        self.time = math.nan
        self.y = np.zeros(len(self.nominal))
        fmu, size = instance.fmu, len(self.y)
        self._calls = (
            self._filling(fmu.rates if self.count else _still, size, in_vector=True),
            self._filling(fmu.getEventIndicators, indicators, in_vector=False),
        )
        self._solver = Cvode(
            method, self.y, rates=self._calls[0], indicators=self._calls[1], count=indicators,
            rtol=rtol, absolute=0.1 * rtol * self.nominal,
            min_step=0.0, max_step=10.0 * instance.subject.step, max_steps=_STEP_LIMIT,
        )  # fmt: skip

    def jump(self, time: float, inputs: np.ndarray) -> None:
        """Set inputs (nu,) [unit of each input] at `time` [s] in an event; restart the integrator.

        Without inputs it only starts the integrator. Raises FMICallException, Fault.
        """
        instance = self.instance
        if inputs.size:
            instance.set_time(time)
            instance.fmu.enterEventMode()
            instance.set(instance.subject.continuous_inputs, inputs)
            self._settle()
        elif self._solver.memory:
            return
        self.renew(time)

    def renew(self, time: float) -> None:
        """Restart the integrator at `time` [s] from the instance's own states."""
        self.time = time
        if self.count:
            self.y[:] = self.instance.states()
        self._solver.min_step = 4e-16 * max(1.0, abs(time))
        self._solver.renew(time)

    def close(self) -> None:
        """Free the memory of CVODE."""
        self._solver.close()

    def advance(self, target: float) -> None:
        """Integrate to `target` [s] through all events. Raises Crowded if events do not end."""
        instance = self.instance
        while self.time < target:
            if self.time >= self.record.crowded:
                raise Crowded
            stop = min(target, instance.next_event)
            if stop - self.time <= _NO_TIME * max(1.0, abs(stop)):
                self.time = stop
                if stop >= instance.next_event:
                    self._move(stop, self.y)
                    self._event(())
                continue
            flag = self._solver.advance(stop, stop, one_step=instance.wants_steps)
            problem, self.problem = self.problem, None
            if problem is not None:
                raise problem
            if flag < 0:
                raise Misbehaviour(
                    f"CVODE cannot integrate its derivatives beyond t = {self.time:.6g} s ({why(flag)})"
                )
            self.time = self._solver.time
            self._move(self.time, self.y)
            crossed = ()
            if flag == ROOT_RETURN:
                crossed = tuple(np.flatnonzero(self._solver.roots).tolist())
            wanted = instance.wants_steps and not crossed and instance.completed()
            if crossed or wanted or self.time >= instance.next_event:
                self._event(crossed)
        self._move(target, self.y)

    @property
    def is_at_time_event(self) -> bool:
        """Return whether a time event is due now, up to rounding."""
        return self.instance.next_event - self.time <= _NO_TIME * max(1.0, abs(self.time))

    def _event(self, crossed: tuple[int, ...]) -> None:
        events = self.record.events
        indicators = self.instance.indicators()
        if crossed or self.is_at_time_event:
            self._update()
        else:
            self.update_unannounced()
        events.append((self.time, crossed, indicators))
        length = self.instance.subject.step
        if len(events) >= _MOST_EVENTS or (
            len(events) > 20 and self.time - events[-20][0] < 20 * _CROWDED * length
        ):
            self.record.crowded = self.time
        self.renew(self.time)

    def update_unannounced(self) -> None:
        """Update at a time without an announced event, and note all jumps."""
        instance = self.instance
        if not self.count:
            self._update()
            return
        before, rates = instance.states(), instance.rates()
        self._update()
        largest = np.maximum(np.abs(rates).max(), self.nominal)
        for what, old, new, scale in (
            ("state", before, instance.states(), self.nominal),
            ("derivative", rates, instance.rates(), largest),
        ):
            self.record.surprises += self._jumps(what, old, new, scale)

    def _update(self) -> None:
        """Enter Event Mode, update and leave it."""
        self.instance.fmu.enterEventMode()
        self._settle()

    def _settle(self) -> None:
        """Update until nothing changes, leave Event Mode, note states that changed unreported."""
        before = self.instance.states() if self.count else self.y
        if not self.instance.settle() and self.count:
            self.record.unreported += self._jumps(
                "state", before, self.instance.states(), self.nominal
            )

    def _jumps(self, what: str, old: np.ndarray, new: np.ndarray, scale: np.ndarray) -> list[str]:
        """Return a clause about the largest jump of states or derivatives (nx,) [unit of each].

        The list is empty without a jump.
        """
        jump = np.abs(new - old) / np.maximum(np.abs(old), scale)
        place = int(np.argmax(jump))
        if not jump[place] > JUMP:
            return []
        subject = self.instance.subject
        names = (subject.states if what == "state" else subject.derivatives).names
        name = names[place] if place < len(names) else f"{what} {place}"
        return [
            f"{name} from {old[place]:.6g} to {new[place]:.6g} at t = {self.instance.time:.6g} s"
        ]

    def _move(self, time: float, y: np.ndarray) -> None:
        self.instance.move(time, y[: self.count])

    def _filling(self, call: Callable[[Any, int], Any], size: int, *, in_vector: bool) -> Any:
        """Return the function that CVODE calls for derivatives, or indicators.

        in_vector: whether the result is a vector of CVODE, not an array.
        """
        states, values = ctypes.c_double * self.count, ctypes.c_double * size
        unset = values(*[math.nan] * size)

        def fill(time: float, y: int, filled: int, _: None) -> int:
            place = array_of(filled) if in_vector else filled
            ctypes.memmove(place, unset, 8 * size)
            try:
                self.instance.set_time(time)
                if self.count:
                    self.instance.fmu.setContinuousStates(
                        states.from_address(array_of(y)), self.count
                    )
                call(values.from_address(place), size)
            except Exception as error:  # noqa: BLE001 - raised again in advance()
                self.problem = error
                return -1
            return 0

        return FILLS(fill)
