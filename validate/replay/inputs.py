"""The plan's inputs between its nodes: constant over a step, or a line to the next step's value."""

from __future__ import annotations

import numpy as np

from models.trajectory import Hold, Trajectory


class HeldInputs:
    """u(t) of a plan. values, slopes (steps, nu): at the start of each step, and per second within it.

    breaks (steps,): whether u or its slope jumps where step i begins, so that an integrator must start afresh there.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.times = trajectory.t
        self.values = trajectory.u
        self.slopes = np.zeros_like(trajectory.u)
        if trajectory.hold is Hold.LINEAR:
            self.slopes[:-1] = np.diff(trajectory.u, axis=0) / np.diff(trajectory.t)[:-1, None]
        self.linear = bool(self.slopes.any())
        jumps = self.slopes[1:] != self.slopes[:-1]
        if trajectory.hold is Hold.ZERO_ORDER:
            jumps = trajectory.u[1:] != trajectory.u[:-1]
        self.breaks = np.concatenate([[True], jumps.any(axis=1)])

    def stop_after(self, step: int) -> int:
        """The first node after the start of `step` beyond which no integration may go."""
        later = np.flatnonzero(self.breaks[step + 1 :])
        return step + 1 + int(later[0]) if later.size else len(self.breaks)
