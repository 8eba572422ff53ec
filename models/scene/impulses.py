"""Differences of contact impulse between a plan and a motion, for the planner and the judge.

least, most = force_window(motion.lam, step_of, plan.steps)
excess_impulse(plan.lam, most, h)     # force that only the plan has [N s]
excess_impulse(least, plan.lam, h)    # force that only the motion has [N s]
"""

from __future__ import annotations

import numpy as np

from models.trajectory import WINDOWS


def force_window(
    lam: np.ndarray, step_of: np.ndarray, steps: int, mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest forces of a motion from one step before to one after.

    A planned force has any convention, and a contact may be a step early or late.

    Parameters
    ----------
    lam
        Forces at the ends of the motion's pieces, (n, nc) [N].
    step_of
        The plan's step of each piece, (n-1,) [-], not decreasing; each step has a piece.
    steps
        Number of steps of the plan.
    mean
        Mean forces (steps, nc) [N], if known.

    Returns
    -------
    tuple[np.ndarray, np.ndarray]
        Least and largest forces, (steps, nc) [N] each.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    first = np.searchsorted(step_of, np.arange(steps))
    window = []
    for choose in (np.minimum, np.maximum):
        if not lam.shape[1]:
            window.append(np.zeros((steps, 0)))
            continue
        forces = choose.reduceat(choose(lam[:-1], lam[1:]), first, axis=0)
        if mean is not None:
            forces = choose(forces, mean)
        padded = np.concatenate([forces[:1], forces, forces[-1:]])
        window.append(choose(choose(padded[:-2], forces), padded[2:]))
    return window[0], window[1]


def excess_impulse(lam: np.ndarray, other: np.ndarray, h: np.ndarray) -> float:
    """Return the impulse of one force without the other, sum of h max(lam - other, 0) [N s].

    Parameters
    ----------
    lam, other
        Forces (steps, nc) [N].
    h
        Steps (steps,) [s].

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    return float((h[:, None] * np.maximum(lam - other, 0.0)).sum())


def common_impulse(lam: np.ndarray, most: np.ndarray, h: np.ndarray) -> float:
    """Return the impulse that a plan and a motion have in common [N s].

    Parameters
    ----------
    lam
        Forces of the plan (steps, nc) [N].
    most
        Largest forces of the motion (`force_window`), (steps, nc) [N].
    h
        Steps (steps,) [s].

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    return float(h @ np.minimum(np.abs(lam), most).sum(axis=1))


def impulse_yardstick(common: float, typical_force: float, duration: float) -> float:
    """Return the impulse by which differences of contact are measured [N s].

    Parameters
    ----------
    common
        Impulse that plan and motion have in common [N s].
    typical_force
        Typical force of the scene's contacts [N].
    duration
        Duration of the plan [s].

    Raises
    ------
    Nothing.
    """
    return max(typical_force * duration / WINDOWS, common)
