"""The goal of a scene as an augmented Lagrangian: a multiplier and a quadratic penalty for each component that is given."""

from __future__ import annotations

import numpy as np

from models.goal import goal_state, miss
from models.scene import Scene


class GoalTerm:
    """y'm + weight/2 |m|^2 with m = x_T - goal, 0 where the end is free. y (2*nq,): multipliers, from zero."""

    def __init__(self, scene: Scene, weight: float) -> None:
        self._goal = goal_state(scene.task)
        self._given = ~np.isnan(self._goal)
        self.multipliers = np.zeros(len(self._goal))
        self.weight = weight

    @property
    def any(self) -> bool:
        return bool(self._given.any())

    def miss(self, end: np.ndarray) -> np.ndarray:
        """(2*nq,) end - goal."""
        return miss(end, self._goal)

    def value(self, end: np.ndarray) -> float:
        m = self.miss(end)
        return float(self.multipliers @ m + 0.5 * self.weight * m @ m)

    def slope(self, end: np.ndarray) -> np.ndarray:
        return np.where(self._given, self.multipliers + self.weight * self.miss(end), 0.0)

    def hessian(self) -> np.ndarray:
        return np.diag(np.where(self._given, self.weight, 0.0))

    def update(self, end: np.ndarray) -> None:
        """The first-order update: y <- y + weight (x_T - goal)."""
        self.multipliers += np.where(self._given, self.weight * self.miss(end), 0.0)
