"""Our FMU as reference: Model Exchange by CVODE, stopped at every event."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing

import numpy as np

from models.fmu import build_fmu
from validate.fmi.description import Package, read_package, unpacked
from validate.judge.engines.simulator import Drive, SimulatedMotion, Simulator
from validate.judge.replay.reference import ExchangeModel, integrate
from validate.judge.replay.result import Run
from validate.judge.replay.run import EVENT_BUDGET
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs, Variables

ENGINE = Simulator(
    title="our FMU, reference (CVODE)",
    tolerances=(1e-7, 1e-9, 1e-11, 1e-13),
    law="the scene's own, events located",
)


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises FmuError."""

    def steps(package: Package, variables: Variables, inputs: HeldInputs) -> Run:
        """Integrate the Model Exchange. Raises FmuError."""
        with closing(ExchangeModel(package, variables)) as model:
            return integrate(model, drive.start, inputs, drive.tolerance, EVENT_BUDGET)

    return motion_of(drive, steps)


def motion_of(
    drive: Drive, steps: Callable[[Package, Variables, HeldInputs], Run]
) -> SimulatedMotion:
    """Return the motion of our FMU by `steps` at the plan's nodes, NaN once it ended.

    Raises FmuError.
    """
    with unpacked(read_package(build_fmu(drive.scene))) as package:
        variables, nq = find_variables(package, drive.scene), drive.scene.nq
        began = time.process_time()
        run = steps(package, variables, HeldInputs(drive.plan, drive.feedback))
        seconds = time.process_time() - began
    states = np.full((len(drive.plan.t), 2 * nq), np.nan)
    rows = np.array(run.outputs)[run.knots, : 2 * nq]
    states[: len(rows)] = rows
    applied = (
        None
        if drive.feedback is None
        else np.array(run.applied).reshape(len(run.applied), drive.scene.nu)
    )
    return SimulatedMotion(q=states[:, :nq], v=states[:, nq:], seconds=seconds, applied=applied)
