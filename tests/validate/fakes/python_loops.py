"""The loops of a replay in Python, one call of FMI at a time: what the compiled ones must do, call by call and bit for bit.

# CVODE through scikit-sundae; of any ContinuousModel
integrate(PythonModel(package, variables), ...)
# validate.judge.replay.everyday.simulate with this loop in place of that of loops.c
simulate(package, variables, ...)
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol
from unittest.mock import patch

import numpy as np
from fmpy.fmi1 import FMICallException
from sksundae.cvode import CVODE

from validate.fmi.description import Package
from validate.judge.replay import everyday
from validate.judge.replay.everyday import Stepping, early_return
from validate.judge.replay.reference import ABSOLUTE_FRACTION, PARTS, STEP_LIMIT, ExchangeModel
from validate.judge.replay.result import DIVERGENCE, ReplayOutcome, Run, Stop
from validate.judge.replay.wiring import HeldInputs, Variables

_TSTOP_RETURN = 1
_ROOT_RETURN = 2


class ContinuousModel(Protocol):
    """What is integrated. x (nx,): the model's states.

    rates: dx/dt and then the rates of `accumulated` quantities.

    outputs: number of values `read` gives; indicators: number of event functions; nominal (nx,):
        typical size of each state; wants_steps: whether
    `step_completed` must be called after every internal step; next_event: time of the next event
        the model knows of [s], infinite without.
    """

    nominal: np.ndarray
    accumulated: int
    indicators: int
    outputs: int
    wants_steps: bool

    @property
    def next_event(self) -> float: ...

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray: ...

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None: ...

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None: ...

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None: ...

    def read(self, time: float, y: np.ndarray) -> np.ndarray: ...

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray: ...

    def step_completed(self, time: float, y: np.ndarray) -> bool: ...


class PythonModel(ExchangeModel):
    """An FMU as a ContinuousModel."""

    def __init__(self, package: Package, variables: Variables) -> None:
        super().__init__(package, variables)
        self.wants_steps = self.instance.wants_steps

    @property
    def next_event(self) -> float:
        return self.instance.next_event

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None:
        self.instance.write(self.references[2], u)

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None:
        self.move(time, y)
        rates[: self.states] = self.instance.rates()
        rates[self.states :] = self.instance.read(self.references[0])

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None:
        self.move(time, y)
        values[:] = self.instance.indicators()

    def step_completed(self, time: float, y: np.ndarray) -> bool:
        self.move(time, y)
        return self.instance.completed()


def integrate(
    model: ContinuousModel,
    start: np.ndarray,
    inputs: HeldInputs,
    rtol: float,
    event_budget: int,
    *,
    parts: int = PARTS,
    max_step: float = math.inf,
) -> Run:
    """What validate.judge.replay.reference.integrate says."""
    run = Run()
    try:
        _Integration(model, inputs, rtol, event_budget, run, parts, max_step).over_all_steps(start)
    except Stop as stop:
        run.outcome, run.message = stop.outcome, stop.message
    except FMICallException as error:
        run.end_refused(error, float(inputs.times[0]))
    return run


class _Integration:
    """One run in progress. targets (steps, parts): the points recorded within each step of the plan, the last its end [s]; y: the states and
    what is accumulated at the last of them.
    """

    def __init__(
        self,
        model: ContinuousModel,
        inputs: HeldInputs,
        rtol: float,
        event_budget: int,
        run: Run,
        parts: int,
        max_step: float,
    ) -> None:
        self.model, self.inputs, self.rtol, self.event_budget, self.run = (
            model,
            inputs,
            rtol,
            event_budget,
            run,
        )
        self.step = 0
        self.bound, self.y = np.empty(0), np.empty(0)
        self.solver: Any = None
        begin, end = inputs.times[:-1], inputs.times[1:]
        inner = [begin + (end - begin) * point / parts for point in range(1, parts)]
        self.targets = np.column_stack([*inner, end])
        # Smaller steps than this do not change the time any more.
        self.min_step = 4e-16 * float(np.abs(inputs.times).max())
        self.max_step = min(float(np.ptp(inputs.times)), max_step)

    def over_all_steps(self, start: np.ndarray) -> None:
        times, values = self.inputs.times, self.inputs.values
        x = self.model.start(times[0], start, self.inputs.begin(0, None))
        self.bound = DIVERGENCE * np.maximum(self.model.nominal, np.abs(x))
        self.y = np.concatenate([x, np.zeros(self.model.accumulated)])
        self.record(times[0], self.y, knot=True)
        self.renew(times[0], self.y)
        stop = times[self.inputs.stops[0]]
        for step in range(len(values)):
            self.step = step
            feedback = self.inputs.feedback
            if step:
                self.inputs.begin(
                    step,
                    None
                    if feedback is None
                    else self.run.outputs[-1][: feedback.reference.shape[1]],
                )
            if feedback is not None:
                self.run.applied.append(values[step].copy())
            if step and self.inputs.breaks[step]:
                # Inputs that jump are an event of the FMU; a new slope is not, but the integrator
                # must start afresh as well.
                self.jump(
                    times[step],
                    values[step],
                    is_event=not self.inputs.linear or feedback is not None,
                )
                stop = times[self.inputs.stops[step]]
            self.over_points(stop)

    def jump(self, time: float, values: np.ndarray, is_event: bool) -> None:
        """Go on afresh from `time` with other inputs, values (nu,), or other slopes."""
        if is_event:
            self.y = self.model.event(time, self.y, values)
        self.solver.init_step(time, self.y)

    def over_points(self, stop: float) -> None:
        """Integrate over the plan's step in progress, through every event in it, and record its points. stop [s]: beyond which no integration may go."""
        *inner, end = self.targets[self.step].tolist()
        for target in inner:
            self.advance(target, stop)
        self.advance(end, stop, knot=True)

    def advance(self, target: float, stop: float, knot: bool = False) -> None:
        """Integrate to `target`, through every event before it, and record it."""
        mode = "onestep" if self.model.wants_steps else "normal"
        while True:
            # An FMU that wants to know each internal step is integrated up to every recorded point,
            # the others past it. Beyond an event that the model knows of no integration may go
            # either.
            known = self.model.next_event
            result = self.solver.step(
                min(target, known), mode, min(target if self.model.wants_steps else stop, known)
            )
            time, y = float(result.t), result.y
            if result.status < 0:
                self.within_bounds(time, y)
                raise Stop(
                    ReplayOutcome.INTEGRATION_FAILED,
                    f"CVODE stopped at t = {time:.6g} s: {result.message}",
                )
            wanted = (
                self.model.wants_steps
                and result.status != _ROOT_RETURN
                and self.model.step_completed(time, y)
            )
            is_due = result.status != _ROOT_RETURN and time >= known
            if result.status == _ROOT_RETURN or wanted or is_due:
                if result.status == _ROOT_RETURN:
                    self.note(time, result.i_events[-1])
                if self.after_event(time, y, target, knot):
                    return
                continue
            if mode == "onestep" and result.status != _TSTOP_RETURN and time < target:
                continue
            self.record(target, y, knot=knot)
            self.y = y
            return

    def after_event(self, time: float, y: np.ndarray, target: float, knot: bool) -> bool:
        """The FMU's event at (time, y), its record, and a new solver from there.

        Whether it fell on the point `target`, but for rounding.
        """
        self.y = self.model.event(time, y, None)
        falls_on_it = abs(target - time) <= 1e-13 * max(1.0, abs(target))
        time = target if falls_on_it else time
        self.record(time, self.y, knot=knot and falls_on_it)
        self.renew(time, self.y)
        return falls_on_it

    def absolute_tolerances(self) -> np.ndarray:
        """(states and accumulated)."""
        return (
            ABSOLUTE_FRACTION
            * self.rtol
            * np.concatenate([self.model.nominal, np.ones(self.model.accumulated)])
        )

    def renew(self, time: float, y: np.ndarray) -> None:
        """A new solver from (time, y): after an event (sksundae's own list of events would grow for ever otherwise)."""
        options: dict[str, Any] = {}
        if self.model.indicators:
            options = {"eventsfn": self.gaps(), "num_events": self.model.indicators}
        self.solver = CVODE(
            self.right_hand_side(), method="Adams", rtol=self.rtol, atol=self.absolute_tolerances(),
            max_num_steps=STEP_LIMIT,
            min_step=self.min_step, max_step=self.max_step, **options,
        )  # fmt: skip
        self.solver.init_step(time, y)

    def right_hand_side(self) -> Callable[[float, np.ndarray, np.ndarray], None]:
        model, inputs = self.model, self.inputs

        def rates(time: float, y: np.ndarray, yp: np.ndarray) -> None:
            if inputs.linear:
                step = self.step
                model.set_inputs(
                    inputs.values[step] + inputs.slopes[step] * (time - inputs.times[step])
                )
            model.rates(time, y, yp)
            if not math.isfinite(sum(yp.tolist())):
                raise Stop(
                    ReplayOutcome.NOT_A_NUMBER,
                    f"A rate of change was not a finite number at t = {time:.6g} s.",
                )

        return rates

    def gaps(self) -> Callable[[float, np.ndarray, np.ndarray], None]:
        model = self.model

        def gaps(time: float, y: np.ndarray, values: np.ndarray) -> None:
            model.indicate(time, y, values)

        return gaps

    def within_bounds(self, time: float, y: np.ndarray) -> None:
        """Raise Stop where a state has left every bound, or anything is no finite number."""
        if not (np.abs(y[: len(self.bound)]) < self.bound).all():
            raise Stop(ReplayOutcome.DIVERGED, f"A state left every bound at t = {time:.6g} s.")
        if not np.isfinite(y).all():
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"Work or impulse was not a finite number at t = {time:.6g} s.",
            )

    def note(self, time: float, crossed: np.ndarray) -> None:
        """Count an event; the sign CVODE gives is that of the indicator's slope."""
        for indicator in np.flatnonzero(crossed):
            self.run.events.append((time, int(indicator), bool(crossed[indicator] < 0)))
        if len(self.run.events) > self.event_budget:
            raise Stop(
                ReplayOutcome.EVENT_BUDGET,
                f"More than {self.event_budget} contact events by t = {time:.6g} s.",
            )

    def record(self, time: float, y: np.ndarray, knot: bool = False) -> None:
        self.within_bounds(time, y)
        outputs = self.model.read(time, y)
        if not np.isfinite(outputs).all():
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"An output was not a finite number at t = {time:.6g} s.",
            )
        if knot:
            self.run.knots.append(len(self.run.t))
        self.run.t.append(time)
        self.run.outputs.append(outputs)
        self.run.accumulated.append(np.array(y[len(self.bound) :]))


def simulate(
    package: Package,
    variables: Variables,
    start: np.ndarray,
    inputs: HeldInputs,
    fineness: int,
) -> Run:
    """What validate.judge.replay.everyday.simulate says."""
    with patch.object(everyday, "step_through", _step_through):
        return everyday.simulate(package, variables, start, inputs, fineness)


def _step_through(stepping: Stepping, run: Run) -> None:
    fmu, inputs, times = stepping.fmu, stepping.inputs, stepping.inputs.times
    given, states = stepping.given, stepping.states
    for step in range(len(inputs.values)):
        begin, length = float(times[step]), float(times[step + 1] - times[step])
        value = inputs.begin(step, run.outputs[-1][:states])
        if inputs.feedback is not None:
            run.applied.append(value.copy())

        def advance(
            calls: int,
            begin: float = begin,
            length: float = length,
            step: int = step,
            value: np.ndarray = value,
        ) -> None:
            for call in range(calls):
                if given.count:
                    at = call if stepping.slopes or not inputs.linear else call + 0.5
                    fmu.write(given, value + inputs.slopes[step] * (length * at / calls))
                    if stepping.slopes:
                        fmu.fmu.setRealInputDerivatives(
                            given.array, [1] * given.count, inputs.slopes[step]
                        )
                # Communication points are taken from the grid, never summed up.
                answer = fmu.fmu.step(begin + length * call / calls, length / calls)
                if answer.early:
                    raise early_return(answer.reached)

        advance(stepping.parts)
        time, values = float(times[step + 1]), fmu.read(stepping.outputs).copy()
        if not np.isfinite(values).all():
            run.end_without_number(time)
            return
        if np.abs(values[:states]).max(initial=0.0) > DIVERGENCE:
            run.end_out_of_bounds(time)
            return
        run.knots.append(len(run.t))
        run.t.append(time)
        run.outputs.append(values)
