"""Drake's discrete plant with SAP: fixed steps, convex contact."""

from __future__ import annotations

import numpy as np

from validate.judge.engines.adapters._drake import Plant
from validate.judge.engines.simulator import (
    CannotExpressError,
    Drive,
    SimulatedMotion,
    Simulator,
    stepped,
)

ENGINE = Simulator(
    title="Drake, discrete (SAP)",
    package="pydrake",
    extra="bench-drake",
    law="points between balls and half-spaces, Kelvin and Voigt, convex: friction opens what slides; its regularisation is not to be set",
)


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises CannotExpressError."""
    if not np.allclose(np.diff(drive.plan.t), drive.step * drive.parts, rtol=1e-9, atol=0.0):
        raise CannotExpressError(
            "the plan's steps differ in length, and a discrete plant has one step"
        )
    plant = Plant(drive, time_step=drive.step)

    def advance(
        u: np.ndarray, slope: np.ndarray, count: int, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return q, v (nq,) [m, rad, m/s, rad/s] after count steps of h [s]. Raises nothing.

        u: (nu,) [N, N m]; slope: (nu,) [N/s, N m/s].
        """
        for part in range(count):
            plant.drive_by(u + slope * h * (part + 0.5))
            updated = plant.diagram.EvalUniquePeriodicDiscreteUpdate(plant.context)
            plant.context.SetDiscreteState(updated)
        return plant.state()

    return stepped(drive, advance)
