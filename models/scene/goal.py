"""Where a plan is to end, as numbers: a component that the task leaves free is NaN, and misses nothing.

goal = goal_state(scene.task)             # (2*nq,), NaN where free
miss(end, goal)                           # end - goal, 0 where free
"""

from __future__ import annotations

import numpy as np

from models.scene import Task


def goal_state(task: Task) -> np.ndarray:
    """The goal as numbers.

    Parameters
    ----------
    task
        The task.

    Returns
    -------
    np.ndarray
        (2*nq,) positions, then velocities [m, rad, m/s, rad/s]; NaN where the end is free.
    """
    return np.array(task.goal, dtype=float)


def miss(end: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """How far an end is from the goal: end - goal, 0 where the goal is free.

    Parameters
    ----------
    end, goal
        All of the state (2*nq,) or its first part [m, rad, m/s, rad/s].

    Returns
    -------
    np.ndarray
        Of the same shape.

    Raises
    ------
    ValueError
        For ends of different lengths.
    """
    return np.where(np.isnan(goal), 0.0, end - goal)


def distance(end: np.ndarray, goal: np.ndarray) -> float:
    """Norm of `miss`.

    Parameters
    ----------
    end, goal
        All of the state (2*nq,) or its first part [m, rad, m/s, rad/s].

    Returns
    -------
    float
        The norm, of metres and radians alike [m, rad, m/s, rad/s].

    Raises
    ------
    ValueError
        For ends of different lengths.
    """
    return float(np.linalg.norm(miss(end, goal)))
