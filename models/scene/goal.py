"""Where a plan is to end, as numbers: a component that the task leaves free is NaN, and misses nothing.

goal = goal_state(scene.task)             # (2*nq,), NaN where free
miss(end, goal)                           # end - goal, 0 where free
"""

from __future__ import annotations

import numpy as np

from models.scene import Task


def goal_state(task: Task) -> np.ndarray:
    """(2*nq,) positions, then velocities [m, rad, m/s, rad/s]; NaN where the end is free."""
    return np.array(task.goal, dtype=float)


def miss(end: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """end - goal, 0 where the goal is free; both of one shape, all of the state or its first part."""
    return np.where(np.isnan(goal), 0.0, end - goal)


def distance(end: np.ndarray, goal: np.ndarray) -> float:
    """Norm of `miss`."""
    return float(np.linalg.norm(miss(end, goal)))
