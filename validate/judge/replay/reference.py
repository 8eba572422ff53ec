"""Reference integrator: CVODE over a Model Exchange FMU, stopped at gap events and input jumps.

    run = integrate(ExchangeModel(..), start, inputs, rtol=1e-13, event_budget=10_000)

Between stops the right-hand side is smooth, so order and error control hold. Adams' method (orders
1 to 12) needs half the evaluations of BDF, because contacts are nearly undamped springs. The loop
(loops.c) makes one call per plan step and one per event.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi import cvode, loops
from validate.fmi.cvode import ADAMS, ROOT_RETURN, Cvode
from validate.fmi.description import Package
from validate.fmi.instance import References, load_instance
from validate.fmi.loops import SOLVER, Reason, address_of, structure
from validate.judge.replay.result import DIVERGENCE, ReplayOutcome, Run, Stop
from validate.judge.replay.wiring import HeldInputs, Variables

# Recorded points per step of the plan, so that motion between nodes is visible.
PARTS = 3
# Limit of internal steps to the next point; a step of three_cart takes about 20.
STEP_LIMIT = 100_000
# Absolute tolerance over rtol * nominal; resolves small coordinates such as penetrations.
ABSOLUTE_FRACTION = 0.1
# Relative rounding of a time.
_ROUNDING = 1e-14

_CALLED = (
    "GetReal", "SetReal", "SetTime", "SetContinuousStates", "GetContinuousStates", "GetDerivatives",
    "GetEventIndicators",
    "CompletedIntegratorStep", "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode",
)  # fmt: skip


class ExchangeModel:
    """An FMU for Model Exchange; a refused FMI call raises FMICallException.

    nominal: (states,) typical sizes; references: of rates, outputs and inputs.
    """

    def __init__(self, package: Package, variables: Variables) -> None:
        self._variables = variables
        self.instance = load_instance(package, "ME")
        self.states, self.indicators = self.instance.state_count, self.instance.indicator_count
        self.accumulated, self.outputs = len(variables.rates), len(variables.outputs)
        self.nominal = np.ones(self.states)
        self.references = (
            References(variables.rates),
            References(variables.outputs),
            References(variables.u),
        )

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Initialise; return the continuous states (states,) [unit of each state].

        Parameters
        ----------
        time
            Start of the plan [s].
        state
            (n,) start values [unit of each variable], in the order of Variables.start.
        u
            (nu,) first inputs [unit of each input].

        Raises
        ------
        FMICallException, Fault
            If the FMU refuses a call, does not settle, or ends.
        """
        fmu, variables = self.instance, self._variables
        fmu.choose(variables.choices)
        settings = [*variables.parameters, *zip(variables.start, state.tolist(), strict=True)]
        fmu.initialise(time, settings, self.references[2], u)
        fmu.settle()
        x, nominal = fmu.states(), fmu.nominals()
        self.nominal = np.where(np.isfinite(nominal) & (nominal > 0), nominal, 1.0)
        return x

    def read(self, time: float, y: np.ndarray) -> np.ndarray:
        """Return the outputs (outputs,) [unit of each] at a time [s] and y (states + accumulated,).

        Order: q, v, lam, gap, friction, energies. Raises FMICallException.
        """
        self.move(time, y)
        return self.instance.read(self.references[1]).copy()

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Run event mode at a time [s] and y (states + accumulated,); return y afterwards.

        u: (nu,) new inputs [unit of each input], None keeps the old ones. Raises FMICallException
        or Fault if the FMU refuses a call, does not settle, or ends.
        """
        fmu = self.instance
        self.move(time, y)
        fmu.fmu.enterEventMode()
        if u is not None:
            fmu.write(self.references[2], u)
        return np.concatenate([fmu.states(), y[self.states :]]) if fmu.settle() else y

    def jacobian(
        self, time: float, x: np.ndarray, unknowns: Sequence[int], knowns: Sequence[int]
    ) -> np.ndarray:
        """Return directional derivatives (unknowns, knowns) [unit of unknown per unit of known].

        At a time [s] and states x (states,); unknowns, knowns: value references. Raises
        FMICallException.
        """
        self.move(time, x)
        columns = [
            self.instance.fmu.directional(unknowns, [known], [1.0], len(unknowns))
            for known in knowns
        ]
        return np.array(columns, dtype=float).reshape(len(knowns), len(unknowns)).T

    def move(self, time: float, y: np.ndarray) -> None:
        """Set time [s] and states of y (states + accumulated,). Raises FMICallException."""
        self.instance.move(time, y[: self.states])

    def close(self) -> None:
        """Free the instance and its library."""
        self.instance.unload()


def integrate(
    model: ExchangeModel,
    start: np.ndarray,
    inputs: HeldInputs,
    rtol: float,
    event_budget: int,
    *,
    parts: int = PARTS,
    max_step: float = math.inf,
) -> Run:
    """Integrate over the plan's grid; numerical failure is the run's outcome.

    Parameters
    ----------
    model
        A fresh FMU.
    start
        (n,) start values [unit of each variable], in the order of Variables.start.
    rtol
        Relative tolerance of CVODE [-].
    event_budget
        Events after which the run ends.
    parts
        Recorded points per step of the plan.
    max_step
        Largest step of the integrator [s].

    Raises
    ------
    Fault
        If the FMU does not settle, or ends.
    MachineError
        Without a compiler or CVODE.
    """
    run = Run()
    integration = _Integration(model, inputs, rtol, event_budget, run, parts, max_step)
    try:
        integration.over_all_steps(start)
    except Stop as stop:
        run.outcome, run.message = stop.outcome, stop.message
    except FMICallException as error:
        run.end_refused(error, float(inputs.times[0]))
    finally:
        integration.close()
    return run


class _Integration:
    def __init__(
        self,
        model: ExchangeModel,
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
        begin, end = inputs.times[:-1], inputs.times[1:]
        inner = [begin + (end - begin) * point / parts for point in range(1, parts)]
        self.targets = np.column_stack([*inner, end])
        self._loops = loops.load()
        rates, outputs, input_references = model.references
        fmu = loops.describe(
            model.instance,
            _CALLED,
            inputs=input_references,
            outputs=outputs,
            rates=rates,
            states=model.states,
            indicators=model.indicators,
        )
        size, (steps, points) = model.states + model.accumulated, self.targets.shape
        self.y = np.empty(size)
        self._values, self._slopes, self._applied = (np.zeros(fmu.inputs) for _ in range(3))
        self._outputs, self._sums = (
            np.empty((steps, points, model.outputs)),
            np.empty((steps, points, model.accumulated)),
        )
        self._targets_at, self._outputs_at, self._sums_at = map(
            address_of, (self.targets, self._outputs, self._sums)
        )
        self._absolute, self._bound = np.empty(size), np.empty(model.states)
        self._loop = structure("integration")(
            fmu=fmu, solver=(ctypes.c_void_p * len(SOLVER))(*map(cvode.address, SOLVER)),
            wants_steps=model.instance.wants_steps,
            linear=inputs.linear, bound=address_of(self._bound), values=address_of(self._values),
            slopes=address_of(self._slopes),
            applied=address_of(self._applied), y=address_of(self.y),
        )  # fmt: skip
        self._at = ctypes.addressof(self._loop)
        self._solver = Cvode(
            ADAMS, self.y, rates=self._loops.integration_rates,
            indicators=self._loops.integration_indicators, count=model.indicators,
            data=self._at, rtol=rtol, absolute=self._absolute, max_steps=STEP_LIMIT,
            # Smaller steps do not change the time.
            min_step=4e-16 * float(np.abs(inputs.times).max()),
            max_step=min(float(np.ptp(inputs.times)), max_step),
        )  # fmt: skip
        self._loop.roots = address_of(self._solver.roots)

    def over_all_steps(self, start: np.ndarray) -> None:
        """Integrate from start (n,) [unit of each variable] to the plan's end, into `run`.

        Raises Stop if the run fails, FMICallException, Fault.
        """
        model, inputs, run = self.model, self.inputs, self.run
        times = inputs.times
        x = model.start(times[0], start, inputs.begin(0, None))
        self._bound[:] = DIVERGENCE * np.maximum(model.nominal, np.abs(x))
        self._absolute[:] = (
            ABSOLUTE_FRACTION
            * self.rtol
            * np.concatenate([model.nominal, np.ones(model.accumulated)])
        )
        self.y[:] = np.concatenate([x, np.zeros(model.accumulated)])
        self._record(times[0], knot=True)
        self._renew(times[0])
        stop = times[inputs.stops[0]]
        for step in range(len(inputs.values)):
            self.step = step
            feedback = inputs.feedback
            if step:
                inputs.begin(
                    step,
                    None if feedback is None else run.outputs[-1][: feedback.reference.shape[1]],
                )
            if feedback is not None:
                run.applied.append(inputs.values[step].copy())
            if step and inputs.breaks[step]:
                # A jump of inputs is an event of the FMU. A new slope only restarts the integrator.
                self._jump(times[step], is_event=not inputs.linear or feedback is not None)
                stop = times[inputs.stops[step]]
            self._over_points(stop)

    def close(self) -> None:
        self._solver.close()

    def _jump(self, time: float, is_event: bool) -> None:
        self._loop.time = time
        self._set_inputs()
        self._check(
            self._loops.integration_jump(self._at)
            if is_event
            else self._loops.integration_restart(self._at)
        )
        self.model.instance.next_event = self._loop.next_event

    def _over_points(self, stop: float) -> None:
        """Integrate over the current step of the plan, at most to stop [s]."""
        if self.inputs.linear:
            self._set_inputs()
        done, count = 0, self.targets.shape[1]
        while done < count:
            place = self.step * count + done
            outputs, sums = (
                self._outputs_at + 8 * place * self._outputs.shape[2],
                self._sums_at + 8 * place * self._sums.shape[2],
            )
            reason = self._loops.integration_advance(
                self._at, self._targets_at + 8 * place, count - done, stop, outputs, sums
            )
            first, done = done, done + self._loop.reached
            self._take(first, done)
            if reason == Reason.EVENT:
                if self._loop.flag == ROOT_RETURN:
                    self._note(self._loop.time)
                done += self._after_event(
                    self._loop.time, float(self.targets[self.step, done]), knot=done == count - 1
                )
            else:
                self._check(reason)

    def _take(self, first: int, last: int) -> None:
        run, step = self.run, self.step
        run.t.extend(self.targets[step, first:last].tolist())
        run.outputs.extend(self._outputs[step, first:last])
        run.accumulated.extend(self._sums[step, first:last])
        if last == self.targets.shape[1] and first < last:
            run.knots.append(len(run.t) - 1)

    def _note(self, time: float) -> None:
        """Count an event; CVODE's sign is that of the indicator's slope."""
        for indicator in np.flatnonzero(self._solver.roots):
            self.run.events.append((time, int(indicator), bool(self._solver.roots[indicator] < 0)))
        if len(self.run.events) > self.event_budget:
            raise Stop(
                ReplayOutcome.EVENT_BUDGET,
                f"More than {self.event_budget} contact events by t = {time:.6g} s.",
            )

    def _after_event(self, time: float, target: float, knot: bool) -> bool:
        """Process an event and restart; return whether it fell on the point `target`.

        An FMU's own event at a jump of the inputs is left to that jump, which has the new inputs.
        """
        falls_on_it = abs(target - time) <= 10.0 * _ROUNDING * max(1.0, abs(target))
        time = target if falls_on_it else time
        if self._loop.flag == ROOT_RETURN or not (
            falls_on_it and knot and self._jumps_after(self.step)
        ):
            # One rounding later, so that an input that crosses zero here has changed sign.
            line = self._values + self._slopes * (
                time + _ROUNDING * max(1.0, abs(time)) - self._loop.begin
            )
            self.y[:] = self.model.event(time, self.y, line if self.inputs.linear else None)
        self._record(time, knot=knot and falls_on_it)
        self._renew(time)
        return falls_on_it

    def _jumps_after(self, step: int) -> bool:
        """Return whether inputs jump (not only their slopes) at the end of a step."""
        inputs = self.inputs
        return (
            step + 1 < len(inputs.values)
            and bool(inputs.breaks[step + 1])
            and (not inputs.linear or inputs.feedback is not None)
        )

    def _record(self, time: float, knot: bool) -> None:
        self._within_bounds(time)
        outputs = self.model.read(time, self.y)
        if not np.isfinite(outputs).all():
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"An output was not a finite number at t = {time:.6g} s.",
            )
        if knot:
            self.run.knots.append(len(self.run.t))
        self.run.t.append(time)
        self.run.outputs.append(outputs)
        self.run.accumulated.append(self.y[self.model.states :].copy())

    def _renew(self, time: float) -> None:
        self._loop.time, self._loop.next_event = time, self.model.instance.next_event
        self._set_inputs()
        self._solver.renew(time)
        self._loop.memory, self._loop.vector = self._solver.memory, self._solver.vector

    def _set_inputs(self) -> None:
        self._loop.begin = self.inputs.times[self.step]
        self._values[:], self._slopes[:] = (
            self.inputs.values[self.step],
            self.inputs.slopes[self.step],
        )

    def _within_bounds(self, time: float) -> None:
        if not (np.abs(self.y[: self.model.states]) < self._bound).all():
            raise Stop(ReplayOutcome.DIVERGED, f"A state left every bound at t = {time:.6g} s.")
        if not np.isfinite(self.y).all():
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"Work or impulse was not a finite number at t = {time:.6g} s.",
            )

    def _check(self, number: int) -> None:
        reason, time = Reason(number), float(self._loop.time)
        if reason is Reason.DONE:
            return
        if reason is Reason.CALL_REFUSED:
            loops.refuse(self.model.instance, self._loop.fmu)
        if reason in (Reason.WANTS_END, Reason.NEVER_SETTLES):
            loops.unsettled(reason, time)
        if reason is Reason.RATE_NOT_FINITE:
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"A rate of change was not a finite number at t = {self._loop.fault_time:.6g} s.",
            )
        if reason is Reason.OUTPUT_NOT_FINITE:
            raise Stop(
                ReplayOutcome.NOT_A_NUMBER,
                f"An output was not a finite number at t = {time:.6g} s.",
            )
        if reason in (Reason.OUT_OF_BOUNDS, Reason.SUM_NOT_FINITE, Reason.SOLVER_FAILED):
            self._within_bounds(time)
            raise Stop(
                ReplayOutcome.INTEGRATION_FAILED,
                f"CVODE stopped at t = {time:.6g} s: {cvode.why(int(self._loop.flag))}",
            )
        raise RuntimeError(
            f"CVODE refused {'its stop time' if reason is Reason.STOP_TIME_REFUSED else 'to be set up'} at t = {time:.6g} s"
        )
