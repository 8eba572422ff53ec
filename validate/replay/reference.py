"""The reference integrator: CVODE over a continuous model, stopped at every gap event and at every jump of the inputs.

Between two such points the right-hand side is smooth, so the integrator's order and its error control hold; across one they
would not. Adams' method (orders 1 to 12) needs half the evaluations of BDF here: contacts are springs, hardly damped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from validate.replay.exchange import ContinuousModel
from validate.replay.inputs import HeldInputs
from validate.replay.result import ReplayOutcome

# Points recorded within each step of the plan, beside its nodes: enough to see what happens between nodes.
INNER_POINTS = 2
# A state this many times its nominal (and its start) has left every bound.
DIVERGENCE = 1e9
# Internal steps to the next point before the integrator is given up (a step of three_cart takes about 20).
_STEP_LIMIT = 100_000
# The absolute tolerance is this fraction of rtol * nominal, so that small coordinates (penetrations) are resolved too.
_ABSOLUTE_FRACTION = 0.1
_TSTOP_RETURN, _ROOT_RETURN = 1, 2


@dataclass(kw_only=True)
class Run:
    """What one integration recorded: times, outputs of the model and accumulated quantities per point; rows that are nodes;
    events as (time, indicator, closes); with feedback the inputs applied from the start of each step on; with rollback what halving each step changed."""

    t: list[float] = field(default_factory=list)
    outputs: list[np.ndarray] = field(default_factory=list)
    accumulated: list[np.ndarray] = field(default_factory=list)
    knots: list[int] = field(default_factory=list)
    events: list[tuple[float, int, bool]] = field(default_factory=list)
    applied: list[np.ndarray] = field(default_factory=list)
    local: list[np.ndarray] = field(default_factory=list)
    outcome: ReplayOutcome = ReplayOutcome.OK
    message: str = ""


class _Stop(Exception):  # noqa: N818 - it ends a run, and is no error of the program
    def __init__(self, outcome: ReplayOutcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message


def integrate(model: ContinuousModel, start: np.ndarray, inputs: HeldInputs, rtol: float, event_budget: int) -> Run:
    """Integrate over the plan's grid from start (2*nq,). Numerical failure is the run's outcome, never an exception."""
    from validate.replay.fmi import CallError

    run = Run()
    try:
        _Integration(model, inputs, rtol, event_budget, run).over_all_steps(start)
    except _Stop as stop:
        run.outcome, run.message = stop.outcome, stop.message
    except CallError as error:
        reached = run.t[-1] if run.t else float(inputs.times[0])
        run.outcome = ReplayOutcome.FATAL if error.fatal else ReplayOutcome.FMU_FAILED
        run.message = f"{error} (after t = {reached:.6g} s)."
    return run


class _Integration:
    def __init__(self, model: ContinuousModel, inputs: HeldInputs, rtol: float, event_budget: int, run: Run) -> None:
        self.model, self.inputs, self.rtol, self.event_budget, self.run = model, inputs, rtol, event_budget, run
        self.step = 0
        self.bound = np.empty(0)
        self.solver: Any = None

    def over_all_steps(self, start: np.ndarray) -> None:
        times, values = self.inputs.times, self.inputs.values
        x = self.model.start(times[0], start, self.inputs.begin(0, None))
        self.bound = DIVERGENCE * np.maximum(self.model.nominal, np.abs(x))
        y = np.concatenate([x, np.zeros(self.model.accumulated)])
        self.record(times[0], y, knot=True)
        self.renew(times[0], y)
        stop = times[self.inputs.stop_after(0)]
        for step in range(len(values)):
            self.step = step
            begin, end = times[step], times[step + 1]
            feedback = self.inputs.feedback
            if step:
                self.inputs.begin(step, None if feedback is None else self.run.outputs[-1][: feedback.reference.shape[1]])
            if feedback is not None:
                self.run.applied.append(values[step].copy())
            if step and self.inputs.breaks[step]:
                # Inputs that jump are an event of the FMU; a new slope is not, but the integrator must start afresh as well.
                y = y if self.inputs.linear and feedback is None else self.model.event(begin, y, values[step])
                self.solver.init_step(begin, y)
                stop = times[self.inputs.stop_after(step)]
            for point in range(1, INNER_POINTS + 1):
                y = self.advance(begin + (end - begin) * point / (INNER_POINTS + 1), stop)
            y = self.advance(end, stop, knot=True)

    def advance(self, target: float, stop: float, knot: bool = False) -> np.ndarray:
        """Integrate to `target`, through every event before it; record and give the state there."""
        mode = "onestep" if self.model.wants_steps else "normal"
        while True:
            # An FMU that wants to know each internal step is integrated up to every recorded point, the others past it.
            # Beyond an event that the model knows of no integration may go either.
            known = self.model.next_event
            result = self.solver.step(min(target, known), mode, min(target if self.model.wants_steps else stop, known))
            time, y = float(result.t), result.y
            if result.status < 0:
                self.within_bounds(time, y)
                raise _Stop(ReplayOutcome.INTEGRATION_FAILED, f"CVODE stopped at t = {time:.6g} s: {result.message}")
            wanted = self.model.wants_steps and result.status != _ROOT_RETURN and self.model.step_completed(time, y)
            is_due = result.status != _ROOT_RETURN and time >= known
            if result.status == _ROOT_RETURN or wanted or is_due:
                if result.status == _ROOT_RETURN:
                    self.note(time, result.i_events[-1])
                y = self.model.event(time, y, None)
                if abs(target - time) > 1e-13 * max(1.0, abs(target)):
                    self.record(time, y)
                    self.renew(time, y)
                    continue
                time = target  # the event fell on the point but for rounding
                self.renew(time, y)
            elif mode == "onestep" and result.status != _TSTOP_RETURN and time < target:
                continue
            self.record(target, y, knot=knot)
            return y

    def renew(self, time: float, y: np.ndarray) -> None:
        """A new solver from (time, y): after an event (sksundae's own list of events would grow for ever otherwise)."""
        from sksundae.cvode import CVODE  # 0.9 s to import

        nominal = np.concatenate([self.model.nominal, np.ones(self.model.accumulated)])
        options: dict[str, Any] = {}
        if self.model.indicators:
            options = {"eventsfn": self.gaps(), "num_events": self.model.indicators}
        self.solver = CVODE(
            self.right_hand_side(),
            method="Adams",
            rtol=self.rtol,
            atol=_ABSOLUTE_FRACTION * self.rtol * nominal,
            max_num_steps=_STEP_LIMIT,
            # Smaller steps than this do not change the time any more.
            min_step=4e-16 * float(np.abs(self.inputs.times).max()),
            max_step=float(np.ptp(self.inputs.times)),
            **options,
        )
        self.solver.init_step(time, y)

    def right_hand_side(self) -> Callable[[float, np.ndarray, np.ndarray], None]:
        model, inputs = self.model, self.inputs

        def rates(time: float, y: np.ndarray, yp: np.ndarray) -> None:
            if inputs.linear:
                step = self.step
                model.set_inputs(inputs.values[step] + inputs.slopes[step] * (time - inputs.times[step]))
            model.rates(time, y, yp)
            if not math.isfinite(sum(yp.tolist())):
                raise _Stop(ReplayOutcome.NOT_A_NUMBER, f"A rate of change was not a finite number at t = {time:.6g} s.")

        return rates

    def gaps(self) -> Callable[[float, np.ndarray, np.ndarray], None]:
        model = self.model

        def gaps(time: float, y: np.ndarray, values: np.ndarray) -> None:
            model.indicate(time, y, values)

        return gaps

    def within_bounds(self, time: float, y: np.ndarray) -> None:
        """Raise _Stop where a state has left every bound, or anything is no finite number."""
        if not (np.abs(y[: len(self.bound)]) < self.bound).all():
            raise _Stop(ReplayOutcome.DIVERGED, f"A state left every bound at t = {time:.6g} s.")
        if not np.isfinite(y).all():
            raise _Stop(ReplayOutcome.NOT_A_NUMBER, f"Work or impulse was not a finite number at t = {time:.6g} s.")

    def note(self, time: float, crossed: np.ndarray) -> None:
        """Count an event; the sign CVODE gives is that of the indicator's slope."""
        for indicator in np.flatnonzero(crossed):
            self.run.events.append((time, int(indicator), bool(crossed[indicator] < 0)))
        if len(self.run.events) > self.event_budget:
            raise _Stop(ReplayOutcome.EVENT_BUDGET, f"More than {self.event_budget} contact events by t = {time:.6g} s.")

    def record(self, time: float, y: np.ndarray, knot: bool = False) -> None:
        self.within_bounds(time, y)
        outputs = self.model.read(time, y)
        if not np.isfinite(outputs).all():
            raise _Stop(ReplayOutcome.NOT_A_NUMBER, f"An output was not a finite number at t = {time:.6g} s.")
        if knot:
            self.run.knots.append(len(self.run.t))
        self.run.t.append(time)
        self.run.outputs.append(outputs)
        self.run.accumulated.append(np.array(y[len(self.bound) :]))
