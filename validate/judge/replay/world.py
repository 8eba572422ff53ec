"""What the inputs of a plan become in a perturbed world: later, by another gain, with noise.

    WorldInputs(plan, world, feedback=None)          # used like HeldInputs

What worlds there are, validate.judge.robustness.worlds says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.trajectory import Trajectory
from validate.judge.replay.wiring import Feedback, HeldInputs

# Breaks of the inputs that are nearer to one another than this share of a step are one.
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A perturbed world: parameters (np,) and start (2*nq,) [units of the scene], gain (nu,) [-], noise (steps, nu) [unit of each input], delay [s].

    whole: inputs change at the plan's nodes alone, as some FMUs take no other steps: over each step they are the mean of what they would be.
    """

    parameters: np.ndarray
    start: np.ndarray
    gain: np.ndarray
    noise: np.ndarray
    delay: float = 0.0
    whole: bool = False


class WorldInputs(HeldInputs):
    """What a plan's inputs become in a world: later, by another gain, with noise; with feedback, its commands do.

    A command given at a node arrives `delay` later; until the first arrives it is that of the start. rows (nodes,): where the plan's nodes are among the times.
    With feedback a world is never `whole`.
    """

    def __init__(self, plan: Trajectory, world: World, feedback: Feedback | None = None) -> None:
        """Raises ValueError if the shapes of plan, world and feedback do not fit."""
        super().__init__(plan, feedback)
        self._commands, self._world = HeldInputs(plan, feedback), world
        arrivals, shortest = plan.t[:-1] + world.delay, _SAME * float(np.diff(plan.t).min())
        between = arrivals[(arrivals < plan.t[-1] - shortest) & (_to_nearest(arrivals, plan.t) > shortest)]
        self.times = np.union1d(plan.t, between)
        self.rows = np.searchsorted(self.times, plan.t)
        begins = self.times[:-1]
        # Of each step of these times: the plan's step in which it lies, that whose command is in force, and since when it is [s].
        self._lies_in = np.searchsorted(plan.t, begins + shortest, side="right") - 1
        self._command = np.maximum(np.searchsorted(arrivals, begins + shortest, side="right") - 1, 0)
        self._since = np.maximum(begins - arrivals[self._command], 0.0)
        arrived = begins + shortest >= arrivals[self._command]
        self.slopes = np.where(arrived[:, None], self._commands.slopes[self._command], 0.0) * world.gain
        self.linear = bool(self.slopes.any())
        self._added = self._since[:, None] * self._commands.slopes[self._command] * world.gain + world.noise[self._lies_in]
        self.values = self._commands.values[self._command] * world.gain + self._added
        if world.whole:
            lengths, h = np.diff(self.times)[:, None], np.diff(plan.t)[:, None]
            means, self.slopes = (
                np.add.reduceat(part * lengths, self.rows[:-1]) / h for part in (self.values + self.slopes * lengths / 2.0, self.slopes)
            )
            self.times, self.values, self.rows = plan.t, means - self.slopes * h / 2.0, np.arange(len(plan.t))
            begins = plan.t[:-1]
        self.breaks, self._stops = np.full(len(begins), True), list(range(1, len(self.times)))

    @property
    def commands(self) -> np.ndarray:
        """(steps, nu) what is commanded at the plan's nodes [unit of each input]: what an actuator makes of it, and when, is the world's. Raises nothing."""
        return self._commands.values

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """The input at the start of a step of these times: at a node a command is given, from its arrival on it is in force (`HeldInputs.begin`): (nu,) [unit of each], state (2*nq,). Raises nothing."""
        if self.feedback is not None:
            node = int(self._lies_in[step])
            if self.rows[node] == step:
                self._commands.begin(node, self._world.start if state is None else state)
            self.values[step] = self._commands.values[self._command[step]] * self._world.gain + self._added[step]
        return self.values[step]


def _to_nearest(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(n,) distance of each point from the nearest node [s]."""
    after = np.clip(np.searchsorted(nodes, points), 1, len(nodes) - 1)
    return np.minimum(np.abs(points - nodes[after]), np.abs(points - nodes[after - 1]))
