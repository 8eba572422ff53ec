"""The plan's inputs between its nodes: constant over a step, or a line to the next node's value; with feedback, a constant is added over each step."""

from __future__ import annotations

import numpy as np

from models.trajectory import Hold, Trajectory
from validate.replay.feedback import Feedback


class HeldInputs:
    """u(t) of a plan. values, slopes (steps, nu): at the start of each step, and per second within it.

    breaks (steps,): whether u or its slope jumps where step i begins, so that an integrator must start afresh there. With feedback every step begins
    with a jump, and `values` are those of the run in progress: `begin` sets them.
    """

    def __init__(self, trajectory: Trajectory, feedback: Feedback | None = None) -> None:
        self.times = trajectory.t
        self.feedback = feedback
        self.values = trajectory.u if feedback is None else trajectory.u.copy()
        self.slopes = np.zeros_like(trajectory.u)
        if trajectory.hold is Hold.LINEAR:
            h = np.diff(trajectory.t)
            self.slopes[:-1] = np.diff(trajectory.u, axis=0) / h[:-1, None]
            if trajectory.u_end is not None:
                self.slopes[-1] = (trajectory.u_end - trajectory.u[-1]) / h[-1]
        self.linear = bool(self.slopes.any())
        jumps = self.slopes[1:] != self.slopes[:-1]
        if trajectory.hold is Hold.ZERO_ORDER:
            jumps = trajectory.u[1:] != trajectory.u[:-1]
        self.breaks = np.concatenate([[True], jumps.any(axis=1)]) if feedback is None else np.full(trajectory.steps, True)
        steps = np.arange(trajectory.steps)
        # The first break at or after each step, and the end of the plan.
        following = np.minimum.accumulate(np.where(self.breaks, steps, trajectory.steps)[::-1])[::-1]
        self._stops = [*following[1:].tolist(), trajectory.steps]

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """(nu,) the input at the start of a step, with feedback from the state (nx,) there; None: the plan's own start."""
        if self.feedback is not None:
            u = self.feedback.at(step, self.feedback.reference[0] if state is None else state)
            if self.linear:  # the correction is held: it may not lead out of the bounds at the end of the step either
                change = self.slopes[step] * (self.times[step + 1] - self.times[step])
                u = np.clip(u, self.feedback.lower - np.minimum(change, 0.0), self.feedback.upper - np.maximum(change, 0.0))
            self.values[step] = u
        return self.values[step]

    def stop_after(self, step: int) -> int:
        """The first node after the start of `step` beyond which no integration may go."""
        return self._stops[step]
