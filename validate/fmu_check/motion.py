"""Runs of an instance, and how far two of them are apart: communication steps of Co-Simulation, and CVODE with event location over Model Exchange.

A run is a pure function of the instance's state, the steps and the inputs: two runs from equal
states must give equal bits.
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

# Runs that should be equal may differ by this share of a variable's size where an FMU's own
# integrator starts afresh.
_RESTART = 1e-6


def compare(
    subject: Subject, one: np.ndarray, other: np.ndarray, first: int = 0
) -> tuple[float, str]:
    """How far two runs are apart.

    Parameters
    ----------
    subject : the FMU, whose variables are compared.
    one, other : (rows, observed) values of all variables [unit of each variable].
    first : the step of row 0.

    Returns
    -------
    The difference that is largest as a share of the variable's size over the run [-], infinite for
        runs of different length; the variable, the difference
    and the time as a clause, empty where the runs are equal bit for bit.

    Raises
    ------
    ValueError : if the columns are not the observed variables.
    """
    if len(one) != len(other):
        end = subject.time(first + min(len(one), len(other)))
        return (
            np.inf,
            f"the length of the run ({len(one)} against {len(other)} steps) differs by inf at t = {end:.6g} s",
        )
    if np.array_equal(one, other, equal_nan=True):
        return 0.0, ""
    with np.errstate(invalid="ignore"):
        apart = np.where(one == other, 0.0, np.abs(one - other))
    apart = np.where(
        np.isnan(one) & np.isnan(other), 0.0, np.nan_to_num(apart, nan=np.inf, posinf=np.inf)
    )
    size = np.maximum(
        np.nan_to_num(np.abs(one), nan=0.0, posinf=0.0).max(axis=0), subject.observed.scales * 1e-6
    )
    shares = apart / size
    row, column = np.unravel_index(int(np.argmax(shares)), shares.shape)
    where = f"{subject.observed.names[column]} differs by {apart[row, column]:.2g} at t = {subject.time(first + int(row)):.6g} s"
    return float(shares[row, column]), where


def require_equal(
    subject: Subject, one: np.ndarray, other: np.ndarray, clause: str, first: int = 0
) -> None:
    """Raise Failed if two runs differ in any bit.

    Parameters
    ----------
    one, other : (rows, observed) values of all variables [unit of each variable].
    clause : what was done to the second; first: the step of row 0.

    Raises
    ------
    Failed : with the clause, the variable and the time.
    """
    _, where = compare(subject, one, other, first)
    if where:
        raise Failed(f"{clause}, {where}.")


def fresh_run(
    subject: Subject, kind: str, steps: int, name: str = "check", **how: Any
) -> np.ndarray:
    """A run of a fresh instance from its start; how: see `run`.

    Returns
    -------
    (steps + 1, observed) values of all variables [unit of each variable].

    Raises
    ------
    FMICallException, Fault : as `run`.
    """
    with CheckedInstance(subject, kind, name) as instance:
        return run(instance.begin(), 0, steps, **how)


def restart_limit(subject: Subject) -> float:
    """Up to this share a continued run may differ from the first one: the FMU's tolerance, at most 1e-6."""
    return min(subject.tolerance, _RESTART)


# A difference is explained by errors up to this many times their estimates.
SAFETY = 4.0
# Relative tolerance of runs that are compared with each other only.
TOLERANCE = 1e-6
# Internal steps to the next communication point before the integrator is given up.
_STEP_LIMIT = 200_000
# More events than this in one run: it ends here, as does one whose events crowd (a bouncing ball
# that comes to rest).
_MOST_EVENTS = 2000
_CROWDED = 1e-7
# What changes by more than this share of its size at an event update jumps.
JUMP = 1e-8
# Less than this, as a share of the time (of 1 s near 0), is no time to integrate over: what is so
# near a time event is at it. It is 450 units in the last place of 1: a time that an FMU sums up
# from 500 periods, as many as the longest run has steps, is up to 250 units off.
_NO_TIME = 1e-13


@dataclass
class Record:
    """What a run of Model Exchange noted.

    events: (time, indicators that crossed, indicators there); surprises: jumps at events that
        nothing announced, in words; untold: states that an event
    changed and the FMU did not say so, in words; crowded: from when on events crowd.
    """

    events: list[tuple[float, tuple[int, ...], np.ndarray]] = field(default_factory=list)
    surprises: list[str] = field(default_factory=list)
    untold: list[str] = field(default_factory=list)
    crowded: float = math.inf


def _still(rates: Any, _size: int) -> None:
    """The right-hand side of the state that stands still, of an FMU that has none."""
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
) -> np.ndarray:
    """Communication steps first..last, with moving inputs.

    Parameters
    ----------
    instance : in Continuous-Time Mode, or before a step.
    first, last : steps of the subject's grid.
    seed : of the inputs' signal.
    after : after(step) is called when each step is done.
    observe : values after each of them, or only at the end.
    record : where events of Model Exchange are noted.

    Returns
    -------
    (last - first + 1, observed) values of all variables [unit of each variable], at the beginning
        and at each step's end; (1, observed) of the end.

    Raises
    ------
    FMICallException, Fault : if the FMU refuses a call, misbehaves or ends.
    """
    subject = instance.subject
    rows = [instance.observe()] if observe == "each" else []
    exchange = (
        contextlib.closing(Exchange(instance, TOLERANCE, record=record))
        if instance.kind == "ME"
        else contextlib.nullcontext()
    )
    with exchange as mover, contextlib.suppress(Crowded):
        for step in range(first, last):
            if step == first or step % HOLD == 0:
                values = subject.inputs_at(step, seed)
                mover.jump(subject.time(step), values) if mover else instance.set(
                    subject.continuous_inputs, values
                )
            mover.advance(subject.time(step + 1)) if mover else instance.make_step(step)
            if observe == "each":
                rows.append(instance.observe())
            if after is not None:
                after(step)
    return np.array(rows) if observe == "each" else instance.observe()[np.newaxis]


def by_adams_or_bdf(simulate: Callable[[tuple[int, int]], Any]) -> Any:
    """What `simulate` gives with one method of CVODE: Adams where it does, BDF where the model is stiff. Raises Misbehaviour."""
    try:
        return simulate(ADAMS)
    except Misbehaviour:
        return simulate(BDF)


class Exchange:
    """CVODE over an instance in Continuous-Time Mode."""

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
        # An FMU without continuous states still has time and events: a state that stands still lets
        # CVODE find them.
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
        """Begin at `time` [s] with inputs (nu,) [unit of each input], by an event if they change or the integrator has not begun.

        Raises FMICallException, Fault.
        """
        instance = self.instance
        if self._solver.memory or inputs.size:
            instance.set_time(time)
            instance.fmu.enterEventMode()
            instance.set(instance.subject.continuous_inputs, inputs)
            self._settle()
        self.renew(time)

    def renew(self, time: float) -> None:
        """A new solver from the instance's own states."""
        self.time = time
        if self.count:
            self.y[:] = self.instance.states()
        self._solver.min_step = 4e-16 * max(1.0, abs(time))
        self._solver.renew(time)

    def close(self) -> None:
        """Free what CVODE holds."""
        self._solver.close()

    def advance(self, target: float) -> None:
        """Integrate to `target` through all events; the instance is left there.

        Raises Crowded where events do not end.
        """
        instance = self.instance
        while self.time < target:
            if self.time >= self.record.crowded:
                raise Crowded
            stop = min(target, instance.next_event)
            if stop - self.time <= _NO_TIME * max(1.0, abs(stop)):
                self.time = stop  # there already, but for rounding
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
            root = flag == ROOT_RETURN
            wanted = instance.wants_steps and not root and instance.completed()
            if root or wanted or (self.time >= instance.next_event):
                crossed = (
                    tuple(int(place) for place in np.flatnonzero(self._solver.roots))
                    if root
                    else ()
                )
                self._event(crossed)
        self._move(target, self.y)

    @property
    def is_at_time_event(self) -> bool:
        """Whether the next time event is now, but for rounding."""
        return self.instance.next_event - self.time <= _NO_TIME * max(1.0, abs(self.time))

    def _event(self, crossed: tuple[int, ...]) -> None:
        events = self.record.events
        indicators = self.instance.indicators() if self.instance.indicator_count else np.empty(0)
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
        """An event update that no indicator and no time announced: what it makes jump is noted."""
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
        """Event mode and back."""
        self.instance.fmu.enterEventMode()
        self._settle()

    def _settle(self) -> None:
        """Event updates in Event Mode, then out of it: a state that they change, and do not say so, is noted."""
        before = self.instance.states() if self.count else self.y
        if not self.instance.settle() and self.count:
            self.record.untold += self._jumps("state", before, self.instance.states(), self.nominal)

    def _jumps(self, what: str, old: np.ndarray, new: np.ndarray, scale: np.ndarray) -> list[str]:
        """The largest jump of states, or of derivatives, (nx,) [unit of each], in words.

        Nothing if none jumps.
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
        """What CVODE calls for rates, or indicators, at a time and states.

        in_vector: whether into a vector of its own, not an array.
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
            except Exception as error:  # noqa: BLE001 - nothing may pass through CVODE; raised again in advance()
                self.problem = error
                return -1
            return 0

        return FILLS(fill)
