"""The everyday replay: a Co-Simulation FMU with its own fine step, one doStep a step of the plan."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from validate.replay.calls import buffer, close_instance, load_instance, reference_array, set_reals
from validate.replay.inputs import HeldInputs
from validate.replay.package import FmuError, Package, Variables
from validate.replay.reference import DIVERGENCE, Run
from validate.replay.result import ReplayOutcome


def everyday_refusal(package: Package, variables: Variables, inputs: HeldInputs) -> str | None:
    """None, or why the FMU's Co-Simulation cannot replay this plan."""
    if package.cosimulation is None:
        return "the FMU offers no Co-Simulation"
    if inputs.linear and not package.cosimulation.canInterpolateInputs:
        return "the plan's inputs are lines within a step, which the FMU's Co-Simulation does not take"
    return None


def simulate(package: Package, variables: Variables, start: np.ndarray, inputs: HeldInputs, fineness: int) -> Run:
    """Step over the plan's grid from start (2*nq,); outputs and knots are those of the plan's nodes, accumulated stays empty.

    fineness: internal steps a plan step; an FMU without the parameter `internal_step` gets fineness/100 calls of doStep a step.
    """
    from fmpy.fmi1 import FMICallException
    from fmpy.fmi2 import FMU2Slave

    run = Run()
    fmu = load_instance(FMU2Slave, package, package.cosimulation.modelIdentifier if package.cosimulation else "")
    try:
        _initialise(fmu, variables, start, inputs, fineness)
        _step_through(fmu, variables, inputs, 1 if variables.internal_step is not None else max(1, fineness // 100), run)
    except FMICallException as error:
        reached = run.t[-1] if run.t else float(inputs.times[0])
        run.outcome, run.message = ReplayOutcome.FMU_FAILED, f"{error} (after t = {reached:.6g} s)"
    finally:
        close_instance(fmu)
    return run


def _initialise(fmu: Any, variables: Variables, start: np.ndarray, inputs: HeldInputs, fineness: int) -> None:
    times = inputs.times
    fmu.setupExperiment(startTime=float(times[0]), stopTime=None)
    set_reals(fmu, [item for item, _ in variables.parameters], [value for _, value in variables.parameters])
    if variables.internal_step is not None:
        set_reals(fmu, [variables.internal_step], [float(np.diff(times).min()) / fineness])
    set_reals(fmu, variables.q + variables.v, start)
    fmu.enterInitializationMode()
    set_reals(fmu, variables.u, inputs.values[0])
    fmu.exitInitializationMode()


def _step_through(fmu: Any, variables: Variables, inputs: HeldInputs, parts: int, run: Run) -> None:
    count = len(variables.u)
    input_references, output_references = reference_array(variables.u), reference_array(variables.outputs)
    orders = (ctypes.c_int * count)(*([1] * count))
    out, out_view = buffer(len(variables.outputs))
    times = inputs.times
    states = len(variables.q) + len(variables.v)

    def record(time: float) -> bool:
        fmu.fmi2GetReal(fmu.component, output_references, len(variables.outputs), out)
        if not np.isfinite(out_view).all() or np.abs(out_view[:states]).max() > DIVERGENCE:
            run.outcome, run.message = ReplayOutcome.DIVERGED, f"A state left every bound by t = {time:.6g} s."
            return False
        run.knots.append(len(run.t))
        run.t.append(time)
        run.outputs.append(out_view.copy())
        return True

    if not record(float(times[0])):
        return
    for step, value in enumerate(inputs.values):
        begin, length = float(times[step]), float(times[step + 1] - times[step])
        for part in range(parts):
            if count:
                at = value + inputs.slopes[step] * (length * part / parts)
                fmu.fmi2SetReal(fmu.component, input_references, count, (ctypes.c_double * count)(*at))
                if inputs.linear:
                    slopes = (ctypes.c_double * count)(*inputs.slopes[step])
                    fmu.fmi2SetRealInputDerivatives(fmu.component, input_references, count, orders, slopes)
            # Communication points are taken from the grid, never summed up.
            fmu.fmi2DoStep(fmu.component, begin + length * part / parts, length / parts, 1)
        if not record(float(times[step + 1])):
            return


def require_some_method(package: Package, refusal: str | None) -> None:
    """Raise FmuError if the FMU offers no Model Exchange and its Co-Simulation is refused."""
    if package.exchange is None and refusal is not None:
        raise FmuError(f"FMU {package.path}: it offers no Model Exchange, and {refusal}; the plan cannot be replayed.")
