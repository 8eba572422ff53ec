"""The reference integrator: CVODE over a continuous model, stopped at every gap event and at every jump of the inputs.

Between two such points the right-hand side is smooth, so the integrator's order and its error control hold; across one they
would not. Adams' method (orders 1 to 12) needs half the evaluations of BDF here: contacts are springs, hardly damped.

A Model Exchange FMU as a continuous model: states, their rates, gaps and events, as the reference integrator needs them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from validate.fmi.instance import Instance, References, buffer, load_instance
from validate.fmi.package import Package
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import HeldInputs, Variables


class ContinuousModel(Protocol):
    """What the reference integrator drives. x (nx,): the model's states; rates: dx/dt and then the rates of `accumulated` quantities.

    outputs: number of values `read` gives; indicators: number of event functions; nominal (nx,): typical size of each state.
    """

    nominal: np.ndarray
    accumulated: int
    indicators: int
    outputs: int
    wants_steps: bool  # whether `step_completed` must be called after every internal step
    next_event: float  # time of the next event the model knows of [s]; infinite without

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray: ...

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None: ...

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None: ...

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None: ...

    def read(self, time: float, y: np.ndarray) -> np.ndarray: ...

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray: ...

    def step_completed(self, time: float, y: np.ndarray) -> bool: ...


class ExchangeModel:
    """ContinuousModel over an instance for Model Exchange. Every FMI call that fails raises CallError."""

    def __init__(self, package: Package, variables: Variables) -> None:
        description = package.description
        self._variables = variables
        self._fmu = load_instance(package, exchange=True)
        self.states = int(description.numberOfContinuousStates)
        self.indicators = int(description.numberOfEventIndicators)
        self.accumulated = len(variables.rates)
        self.outputs = len(variables.outputs)
        # FMI 3 turned the flag round: steps are told only where the FMU asks for it.
        exchange = description.modelExchange
        self.wants_steps = bool(
            exchange.needsCompletedIntegratorStep if package.is_three else not exchange.completedIntegratorStepNotNeeded
        )
        self.nominal = np.ones(self.states)
        self.next_event = math.inf
        # One buffer a purpose, seen by both C and numpy: the right-hand side allocates nothing.
        self._x, self._x_view = buffer(self.states)
        self._dx, self._dx_view = buffer(self.states)
        self._gaps, self._gaps_view = buffer(self.indicators)
        self._rates = References(variables.rates)
        self._out = References(variables.outputs)
        self._inputs = References(variables.u)

    @property
    def instance(self) -> Instance:
        """What its functions are called of."""
        return self._fmu

    @property
    def references(self) -> tuple[References, References, References]:
        """Of what is accumulated, of outputs, of inputs."""
        return self._rates, self._out, self._inputs

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Initialise at `time` [s] with the plan's start, in the order of Variables.start; the states (nx,)."""
        fmu, variables = self._fmu, self._variables
        settings = [*variables.parameters, *zip(variables.start, state.tolist(), strict=True)]
        fmu.choose(variables.choices)
        fmu.initialise(time, settings, self._inputs, u)
        _, self.next_event = fmu.settle()
        x, x_view = buffer(self.states)
        fmu.states(x, self.states)
        nominal, view = buffer(self.states)
        fmu.nominals(nominal, self.states)
        self.nominal = np.where(np.isfinite(view) & (view > 0), view, 1.0)
        return x_view.copy()

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None:
        self._fmu.write(self._inputs, u)

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None:
        self._move(time, y)
        self._fmu.derivatives(self._dx, self.states)
        rates[: self.states] = self._dx_view
        if self.accumulated:
            rates[self.states :] = self._fmu.read(self._rates)

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None:
        self._move(time, y)
        self._fmu.indicators(self._gaps, self.indicators)
        values[:] = self._gaps_view

    def read(self, time: float, y: np.ndarray) -> np.ndarray:
        """(outputs,) q, v, lam, gap, energies - those that the FMU has."""
        self._move(time, y)
        return self._fmu.read(self._out).copy()

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Event mode at (time, y), with new inputs if u is given; y afterwards (other states, if the FMU changed them)."""
        fmu = self._fmu
        self._move(time, y)
        fmu.enter_event_mode()
        if u is not None:
            self.set_inputs(u)
        changed, self.next_event = fmu.settle()
        if not changed:
            return y
        fmu.states(self._x, self.states)
        return np.concatenate([self._x_view, y[self.states :]])

    def jacobian(self, time: float, x: np.ndarray, unknowns: Sequence[int], knowns: Sequence[int]) -> np.ndarray:
        """(unknowns, knowns) directional derivatives at (time, x), by value references."""
        self._move(time, x)
        return self._fmu.jacobian(unknowns, knowns)

    def step_completed(self, time: float, y: np.ndarray) -> bool:
        """Tell the FMU that the integrator accepted a step; whether it wants an event now."""
        self._move(time, y)
        return self._fmu.step_completed()

    def close(self) -> None:
        self._fmu.close()

    def _move(self, time: float, y: np.ndarray) -> None:
        self._x_view[:] = y[: self.states]
        self._fmu.move(time, self._x, self.states)


# Parts of each step of the plan at whose ends the motion is recorded: enough to see what happens between nodes.
PARTS = 3
# A state this many times its nominal (and its start) has left every bound.
DIVERGENCE = 1e9
# Internal steps to the next point before the integrator is given up (a step of three_cart takes about 20).
STEP_LIMIT = 100_000
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

    def end_without_number(self, time: float) -> None:
        """The outputs at a time [s] are not all finite."""
        self.outcome, self.message = ReplayOutcome.NOT_A_NUMBER, f"An output was not a finite number at t = {time:.6g} s."

    def end_out_of_bounds(self, time: float) -> None:
        """A state is beyond any bound at a time [s] that was stepped to."""
        self.outcome, self.message = ReplayOutcome.DIVERGED, f"A state left every bound by t = {time:.6g} s."


class Stop(Exception):  # noqa: N818 - it ends a run, and is no error of the program
    def __init__(self, outcome: ReplayOutcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message


def integrate(
    model: ContinuousModel,
    start: np.ndarray,
    inputs: HeldInputs,
    rtol: float,
    event_budget: int,
    *,
    parts: int = PARTS,
    max_step: float = math.inf,
    compiled: bool = True,
) -> Run:
    """Integrate over the plan's grid from start (2*nq,). Numerical failure is the run's outcome, never an exception.

    parts: of each step of the plan, at whose ends the motion is recorded; max_step: the integrator's own steps are no longer [s]. compiled: by the loop in C where it can be had (validate.judge.replay.compiled), which gives the same numbers.
    """
    from validate.fmi.instance import CallError
    from validate.judge.replay.compiled.integration import compiled_integration

    run = Run()
    in_c = compiled_integration(model, inputs, rtol, event_budget, run, parts, max_step) if compiled else None
    integration = in_c or Integration(model, inputs, rtol, event_budget, run, parts, max_step)
    try:
        integration.over_all_steps(start)
    except Stop as stop:
        run.outcome, run.message = stop.outcome, stop.message
    except CallError as error:
        reached = run.t[-1] if run.t else float(inputs.times[0])
        run.outcome = ReplayOutcome.FATAL if error.fatal else ReplayOutcome.FMU_FAILED
        run.message = f"{error} (after t = {reached:.6g} s)."
    finally:
        integration.close()
    return run


class Integration:
    """One run in progress. targets (steps, parts): the points recorded within each step of the plan, the last its end [s]; y: the states and
    what is accumulated at the last of them."""

    def __init__(
        self, model: ContinuousModel, inputs: HeldInputs, rtol: float, event_budget: int, run: Run, parts: int, max_step: float
    ) -> None:
        self.model, self.inputs, self.rtol, self.event_budget, self.run = model, inputs, rtol, event_budget, run
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
        stop = times[self.inputs.stop_after(0)]
        for step in range(len(values)):
            self.step = step
            feedback = self.inputs.feedback
            if step:
                self.inputs.begin(step, None if feedback is None else self.run.outputs[-1][: feedback.reference.shape[1]])
            if feedback is not None:
                self.run.applied.append(values[step].copy())
            if step and self.inputs.breaks[step]:
                # Inputs that jump are an event of the FMU; a new slope is not, but the integrator must start afresh as well.
                self.jump(times[step], values[step], is_event=not self.inputs.linear or feedback is not None)
                stop = times[self.inputs.stop_after(step)]
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
            # An FMU that wants to know each internal step is integrated up to every recorded point, the others past it.
            # Beyond an event that the model knows of no integration may go either.
            known = self.model.next_event
            result = self.solver.step(min(target, known), mode, min(target if self.model.wants_steps else stop, known))
            time, y = float(result.t), result.y
            if result.status < 0:
                self.within_bounds(time, y)
                raise Stop(ReplayOutcome.INTEGRATION_FAILED, f"CVODE stopped at t = {time:.6g} s: {result.message}")
            wanted = self.model.wants_steps and result.status != _ROOT_RETURN and self.model.step_completed(time, y)
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
        """The FMU's event at (time, y), its record, and a new solver from there. Whether it fell on the point `target`, but for rounding."""
        self.y = self.model.event(time, y, None)
        falls_on_it = abs(target - time) <= 1e-13 * max(1.0, abs(target))
        time = target if falls_on_it else time
        self.record(time, self.y, knot=knot and falls_on_it)
        self.renew(time, self.y)
        return falls_on_it

    def close(self) -> None:
        """Free what the garbage collector does not."""

    def absolute_tolerances(self) -> np.ndarray:
        """(states and accumulated)."""
        return _ABSOLUTE_FRACTION * self.rtol * np.concatenate([self.model.nominal, np.ones(self.model.accumulated)])

    def renew(self, time: float, y: np.ndarray) -> None:
        """A new solver from (time, y): after an event (sksundae's own list of events would grow for ever otherwise)."""
        from sksundae.cvode import CVODE  # 0.9 s to import

        options: dict[str, Any] = {}
        if self.model.indicators:
            options = {"eventsfn": self.gaps(), "num_events": self.model.indicators}
        self.solver = CVODE(
            self.right_hand_side(),
            method="Adams",
            rtol=self.rtol,
            atol=self.absolute_tolerances(),
            max_num_steps=STEP_LIMIT,
            min_step=self.min_step,
            max_step=self.max_step,
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
                raise Stop(ReplayOutcome.NOT_A_NUMBER, f"A rate of change was not a finite number at t = {time:.6g} s.")

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
            raise Stop(ReplayOutcome.NOT_A_NUMBER, f"Work or impulse was not a finite number at t = {time:.6g} s.")

    def note(self, time: float, crossed: np.ndarray) -> None:
        """Count an event; the sign CVODE gives is that of the indicator's slope."""
        for indicator in np.flatnonzero(crossed):
            self.run.events.append((time, int(indicator), bool(crossed[indicator] < 0)))
        if len(self.run.events) > self.event_budget:
            raise Stop(ReplayOutcome.EVENT_BUDGET, f"More than {self.event_budget} contact events by t = {time:.6g} s.")

    def record(self, time: float, y: np.ndarray, knot: bool = False) -> None:
        self.within_bounds(time, y)
        outputs = self.model.read(time, y)
        if not np.isfinite(outputs).all():
            raise Stop(ReplayOutcome.NOT_A_NUMBER, f"An output was not a finite number at t = {time:.6g} s.")
        if knot:
            self.run.knots.append(len(self.run.t))
        self.run.t.append(time)
        self.run.outputs.append(outputs)
        self.run.accumulated.append(np.array(y[len(self.bound) :]))
