"""What one simulation of our FMU recorded, as the motion of an engine."""

from __future__ import annotations

import numpy as np

from validate.judge.replay.result import Run
from validate.judge.replay.wiring import Variables
from validate.judge.simulator import Drive, SimulatedMotion


def motion_of(drive: Drive, variables: Variables, run: Run, *, steps: int, seconds: float) -> SimulatedMotion:
    """Positions and velocities at the plan's nodes; NaN from where the run ended. variables: in whose order it recorded. Raises IndexError."""
    nq = len(variables.q)
    states = np.full((len(drive.plan.t), 2 * nq), np.nan)
    rows = np.array(run.outputs)[run.knots, : 2 * nq]
    states[: len(rows)] = rows
    applied = None if drive.feedback is None else np.array(run.applied).reshape(len(run.applied), drive.scene.nu)
    return SimulatedMotion(q=states[:, :nq], v=states[:, nq:], steps=steps, seconds=seconds, applied=applied)
