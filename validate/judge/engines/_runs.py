"""Our FMU as an engine, by whatever steps it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from models.fmu import build_fmu
from validate.fmi.description import Package, read_package, unpacked
from validate.judge.replay.result import Run
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs, Variables
from validate.judge.simulator import Drive, SimulatedMotion


def motion_of(drive: Drive, steps: Callable[[Package, Variables, HeldInputs], Run]) -> SimulatedMotion:
    """Positions and velocities at the plan's nodes, NaN from where the run ended. Raises FmuError."""
    with unpacked(read_package(build_fmu(drive.scene, results=False))) as package:
        variables, nq = find_variables(package, drive.scene), drive.scene.nq
        began = time.process_time()
        run = steps(package, variables, HeldInputs(drive.plan, drive.feedback))
        seconds = time.process_time() - began
    states = np.full((len(drive.plan.t), 2 * nq), np.nan)
    rows = np.array(run.outputs)[run.knots, : 2 * nq]
    states[: len(rows)] = rows
    applied = None if drive.feedback is None else np.array(run.applied).reshape(len(run.applied), drive.scene.nu)
    return SimulatedMotion(q=states[:, :nq], v=states[:, nq:], seconds=seconds, applied=applied)
