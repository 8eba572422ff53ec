"""The everyday replay: a Co-Simulation FMU with its own fine step, one doStep a step of the plan."""

from __future__ import annotations

import numpy as np

from validate.fmi.instance import CallError, Instance, References, load_instance
from validate.fmi.package import FmuError, Package
from validate.judge.replay.compiled.stepping import Rollback, step_through
from validate.judge.replay.reference import DIVERGENCE, Run
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import HeldInputs, Variables

# Calls of doStep a plan step, of an FMU that has no internal step to set: its fineness over this.
_FINENESS_OF_A_CALL = 50
_SHORTEST = 0.1


def base_step(times: np.ndarray) -> float:
    """What the internal step is a part of [s]: the plan's shortest step, but no less than a tenth of its mean one, so that a single step of a microsecond
    does not make a thousand times as many of all the others."""
    steps = np.diff(times)
    return float(max(steps.min(), _SHORTEST * steps.mean()))


def everyday_refusal(package: Package, inputs: HeldInputs) -> str | None:
    """None, or why the FMU's Co-Simulation cannot replay this plan."""
    interface = package.cosimulation
    if interface is None:
        return "the FMU offers no Co-Simulation"
    steps = np.diff(inputs.times)
    if not interface.canHandleVariableCommunicationStepSize and not np.allclose(steps, steps[0], rtol=1e-9, atol=0.0):
        return "the plan's steps differ in length, which the FMU's Co-Simulation does not take"
    return None


def _takes_slopes(package: Package) -> bool:
    """Whether inputs may be lines within a communication step. FMI 3.0 has no call for that."""
    return not package.is_three and package.cosimulation is not None and package.cosimulation.canInterpolateInputs


def simulate(
    package: Package,
    variables: Variables,
    start: np.ndarray,
    inputs: HeldInputs,
    fineness: int,
    *,
    rolls_back: bool = False,
    compiled: bool = True,
) -> Run:
    """Step over the plan's grid from start (in the order of Variables.start); outputs and knots are those of the plan's nodes, accumulated stays empty.

    fineness: internal steps a plan step; an FMU without the parameter `internal_step` gets fineness/50 calls of doStep a step. Inputs that
    are lines within a step become stairs of `fineness` calls, each at its middle, for an FMU that takes no slopes: wrong by the square of a stair.
    rolls_back: every step is made at half that fineness too, and taken back (validate.judge.replay.compiled.stepping); what the two differ by is `Run.local`.
    compiled: by the loop in C where it can be had (validate.judge.replay.compiled), which gives the same numbers. Raises RollbackError if the FMU does not
    restore its state.
    """
    run = Run()
    try:
        fmu = load_instance(package, exchange=False)
        try:
            inputs_of, outputs_of = References(variables.u), References(variables.outputs)
            settings = [*variables.parameters, *zip(variables.start, start.tolist(), strict=True)]
            own_step = base_step(inputs.times) / fineness
            if variables.internal_step is not None:
                settings.append((variables.internal_step, own_step))
            fmu.choose(variables.choices)
            fmu.initialise(float(inputs.times[0]), settings, inputs_of, inputs.begin(0, None))
            parts = 1 if variables.internal_step is not None else max(1, fineness // _FINENESS_OF_A_CALL)
            slopes = inputs.linear and _takes_slopes(package)
            states = len(variables.q) + len(variables.v)
            parts = fineness if inputs.linear and not slopes else parts
            if not rolls_back:
                _step_through(fmu, (inputs_of, outputs_of), inputs, parts, slopes, states, run, compiled=compiled)
                return run
            parts = parts if variables.internal_step is not None else 2 * ((parts + 1) // 2)
            with Rollback(fmu, outputs_of, states, variables.internal_step, own_step) as rollback:
                run.local = rollback.differences
                _step_through(fmu, (inputs_of, outputs_of), inputs, parts, slopes, states, run, rollback, compiled=compiled)
        finally:
            fmu.close()
    except CallError as error:
        reached = run.t[-1] if run.t else float(inputs.times[0])
        run.outcome = ReplayOutcome.FATAL if error.fatal else ReplayOutcome.FMU_FAILED
        run.message = f"{error} (after t = {reached:.6g} s)."
    return run


def _step_through(
    fmu: Instance,
    references: tuple[References, References],
    inputs: HeldInputs,
    parts: int,
    slopes: bool,
    states: int,
    run: Run,
    rollback: Rollback | None = None,
    *,
    compiled: bool,
) -> None:
    inputs_of, outputs_of = references
    times = inputs.times

    def record(time: float) -> bool:
        values = fmu.read(outputs_of).copy()
        if not np.isfinite(values).all():
            run.end_without_number(time)
            return False
        if np.abs(values[:states]).max(initial=0.0) > DIVERGENCE:
            run.end_out_of_bounds(time)
            return False
        run.knots.append(len(run.t))
        run.t.append(time)
        run.outputs.append(values)
        return True

    if not record(float(times[0])):
        return
    if compiled and step_through(fmu, references, inputs, parts, slopes, states, run, rollback):
        return
    for step in range(len(inputs.values)):
        begin, length = float(times[step]), float(times[step + 1] - times[step])
        value = inputs.begin(step, run.outputs[-1][:states])
        if inputs.feedback is not None:
            run.applied.append(value.copy())

        def advance(calls: int, begin: float = begin, length: float = length, step: int = step, value: np.ndarray = value) -> None:
            for call in range(calls):
                if inputs_of.count:
                    at = call if slopes or not inputs.linear else call + 0.5
                    fmu.write(inputs_of, value + inputs.slopes[step] * (length * at / calls))
                    if slopes:
                        fmu.input_slopes(inputs_of, inputs.slopes[step])
                # Communication points are taken from the grid, never summed up.
                fmu.do_step(begin + length * call / calls, length / calls)

        if rollback is None:
            advance(parts)
        else:
            rollback.step(advance, parts, run.outputs[-1])
        if not record(float(times[step + 1])):
            return


def require_some_method(package: Package, refusal: str | None) -> None:
    """Raise FmuError if the FMU offers no Model Exchange and its Co-Simulation is refused."""
    if package.exchange is None and refusal is not None:
        raise FmuError(f"FMU {package.path}: it offers no Model Exchange, and {refusal}; the plan cannot be replayed.")
