"""The goal of a plan as numbers: a free component is NaN and has no error.

goal = goal_state(scene.task)             # (2*nq,), NaN where free
miss(end, goal)                           # end - goal, 0 where free
"""

from __future__ import annotations

import numpy as np

from models.scene import Task


def goal_state(task: Task) -> np.ndarray:
    """Return the goal as numbers.

    Parameters
    ----------
    task
        The task.

    Returns
    -------
    np.ndarray
        (2*nq,) positions, then velocities [m, rad, m/s, rad/s]; NaN for a free component.
    """
    return np.array(task.goal, dtype=float)


def miss(end: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return the error of an end: end - goal, 0 for a free component.

    Parameters
    ----------
    end, goal
        The whole state (2*nq,) or its first part [m, rad, m/s, rad/s].

    Returns
    -------
    np.ndarray
        The errors, of the same shape and units.

    Raises
    ------
    ValueError
        If the lengths differ.
    """
    return np.where(np.isnan(goal), 0.0, end - goal)


def distance(end: np.ndarray, goal: np.ndarray) -> float:
    """Return the norm of `miss`.

    Parameters
    ----------
    end, goal
        The whole state (2*nq,) or its first part [m, rad, m/s, rad/s].

    Returns
    -------
    float
        The norm, of metres and radians alike [m, rad, m/s, rad/s].

    Raises
    ------
    ValueError
        If the lengths differ.
    """
    return float(np.linalg.norm(miss(end, goal)))
