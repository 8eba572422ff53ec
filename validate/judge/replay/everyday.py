"""Everyday replay: Co-Simulation with a fine internal step, one doStep per plan step (loops.c).

run = simulate(package, variables, start, inputs, fineness=200)
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi import loops
from validate.fmi.description import FmuError, Package
from validate.fmi.instance import Instance, Misbehaviour, References, load_instance
from validate.fmi.loops import Reason, address_of, structure
from validate.judge.replay.result import DIVERGENCE, Run
from validate.judge.replay.wiring import HeldInputs, Variables

# Fineness per call of doStep, for an FMU without a parameter for its internal step.
FINENESS_OF_A_CALL = 50
# Smallest unit of the internal step, over the mean step.
_SHORTEST = 0.1


def base_step(times: np.ndarray) -> float:
    """Return the unit of the internal step [s]: the shortest step of the times (nodes,) [s].

    At least a tenth of the mean step, so that one tiny step does not refine all others. Raises
    ValueError for fewer than two nodes.
    """
    steps = np.diff(times)
    return float(max(steps.min(), _SHORTEST * steps.mean()))


def everyday_refusal(package: Package, inputs: HeldInputs) -> str | None:
    """Return why the FMU's Co-Simulation cannot replay this plan, or None."""
    interface = package.cosimulation
    if interface is None:
        return "the FMU offers no Co-Simulation"
    steps = np.diff(inputs.times)
    if not interface.canHandleVariableCommunicationStepSize and not np.allclose(
        steps, steps[0], rtol=1e-9, atol=0.0
    ):
        return "the plan's steps differ in length, which the FMU's Co-Simulation does not support"
    return None


@dataclass(frozen=True, kw_only=True)
class Stepping:
    """An initialised FMU and its task.

    - parts: doSteps per plan step.
    - slopes: pass input derivatives.
    - states: number of leading outputs that are positions and velocities.
    """

    fmu: Instance
    given: References
    outputs: References
    inputs: HeldInputs
    parts: int
    slopes: bool
    states: int


def simulate(
    package: Package,
    variables: Variables,
    start: np.ndarray,
    inputs: HeldInputs,
    fineness: int,
    *,
    fmu: Instance | None = None,
) -> Run:
    """Step over the plan's grid and record the plan's nodes.

    Parameters
    ----------
    package
        Unpacked, with Co-Simulation.
    start
        (n,) start values [unit of each variable], in the order of Variables.start.
    fineness
        Internal steps per plan step. Without the parameter `internal_step`: fineness/50 doSteps.
        Linear inputs without slopes: `fineness` midpoint stairs, with an error of second order.
    fmu
        A fresh instance that stays loaded; None loads one for this run.

    Raises
    ------
    Fault
        If doStep returns early.
    MachineError
        Without a compiler.
    """
    run, kept = Run(), fmu
    try:
        fmu = fmu or load_instance(package, "CS")
        try:
            internal_step, own_step = (
                [] if variables.internal_step is None else [variables.internal_step],
                base_step(inputs.grid) / fineness,
            )
            input_references, settings = (
                References(variables.u),
                [*variables.parameters, *zip(variables.start, start.tolist(), strict=True)],
            )
            settings += [(reference, own_step) for reference in internal_step]
            fmu.choose(variables.choices)
            fmu.initialise(
                float(inputs.times[0]), settings, input_references, inputs.begin(0, None)
            )
            # FMI 3.0 has no call for inputs that are linear within a step.
            interpolates = (
                package.cosimulation is not None and package.cosimulation.canInterpolateInputs
            )
            slopes = inputs.linear and interpolates and not package.is_three
            parts = 1 if internal_step else max(1, fineness // FINENESS_OF_A_CALL)
            parts = fineness if inputs.linear and not slopes else parts
            stepping = Stepping(
                fmu=fmu, given=input_references, outputs=References(variables.outputs), inputs=inputs,
                parts=parts, slopes=slopes,
                states=len(variables.q) + len(variables.v),
            )  # fmt: skip
            if record_start(stepping, run):
                step_through(stepping, run)
        finally:
            if kept is None:
                fmu.unload()
    except FMICallException as error:
        run.end_refused(error, float(inputs.times[0]))
    return run


def record_start(stepping: Stepping, run: Run) -> bool:
    """Record the outputs at the first node; return False if they end the run."""
    time, values = float(stepping.inputs.times[0]), stepping.fmu.read(stepping.outputs).copy()
    if not np.isfinite(values).all():
        run.end_without_number(time)
    elif np.abs(values[: stepping.states]).max(initial=0.0) > DIVERGENCE:
        run.end_out_of_bounds(time)
    else:
        run.knots.append(0)
        run.t.append(time)
        run.outputs.append(values)
    return bool(run.t)


def step_through(stepping: Stepping, run: Run) -> None:
    """Take all steps of the plan after the first node. Raises FMICallException, Fault."""
    fmu, inputs, states = stepping.fmu, stepping.inputs, stepping.states
    given, width, steps = stepping.given.count, stepping.outputs.count, len(inputs.values)
    called = ["GetReal", "SetReal", "DoStep"]
    called += ["SetRealInputDerivatives"] if stepping.slopes else []
    compiled, described = (
        loops.load(),
        loops.describe(fmu, called, inputs=stepping.given, outputs=stepping.outputs),
    )
    times, values, rates = (
        np.array(array, dtype=float, order="C")
        for array in (inputs.times, inputs.values, inputs.slopes)
    )
    outputs = np.empty((steps + 1, width))
    outputs[0] = run.outputs[0]
    orders, applied = np.ones(given, dtype=np.int32), np.empty(given)
    loop: Any = structure("stepping")(
        fmu=described, times=address_of(times), values=address_of(values), slopes=address_of(rates),
        linear=inputs.linear,
        gives_slopes=stepping.slopes, orders=address_of(orders), parts=stepping.parts,
        bounded=states, bound=DIVERGENCE,
        outputs=address_of(outputs), applied=address_of(applied),
    )  # fmt: skip
    reason, place = Reason.DONE, ctypes.byref(loop)
    if inputs.feedback is None:
        reason = Reason(compiled.step_through(place, 0, steps))
    else:
        for step in range(steps):
            values[step] = inputs.begin(step, outputs[step, :states])
            run.applied.append(values[step].copy())
            reason = Reason(compiled.step_through(place, step, step + 1))
            if reason is not Reason.DONE:
                break
    done = int(loop.done)
    run.knots.extend(range(1, done + 1))
    run.t.extend(times[1 : done + 1].tolist())
    run.outputs.extend(outputs[1 : done + 1])
    if reason is Reason.CALL_REFUSED:
        loops.refuse(fmu, loop.fmu)
    if reason is Reason.EARLY_RETURN:
        raise early_return(loop.reached)
    if reason is Reason.OUTPUT_NOT_FINITE:
        run.end_without_number(times[done + 1])
    elif reason is Reason.OUT_OF_BOUNDS:
        run.end_out_of_bounds(times[done + 1])


def early_return(reached: float) -> Misbehaviour:
    """Return the error of a doStep that returned early, at `reached` [s]."""
    return Misbehaviour(f"it returned early at {reached:g} s, which was not allowed")


def require_some_method(package: Package, refusal: str | None) -> None:
    """Raise FmuError if the FMU offers no Model Exchange and its Co-Simulation is refused."""
    if package.exchange is None and refusal is not None:
        raise FmuError(
            f"FMU {package.path}: it offers no Model Exchange, and {refusal}; the plan cannot be replayed."
        )
