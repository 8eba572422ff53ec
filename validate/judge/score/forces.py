"""Forces of a plan against the contact law, by one convention for the whole plan.

A planned force belongs to the start, middle or end of its step, or is a mean. Within a step the
plan is a cubic through both states; means may also be the replay's, which resolves shorter
contacts.
"""

from __future__ import annotations

import numpy as np

# Points of a step at which the law is evaluated; odd, to include the middle.
_POINTS = 17


def cubic(
    q: np.ndarray, begins: np.ndarray, ends: np.ndarray, s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return place and its derivative by s (n-1, nq) of the cubics between rows, at a share s.

    q: (n, nq) [m or rad]; begins, ends: derivatives by s at both ends, (n-1, nq). Raises ValueError
    if the shapes do not fit.
    """
    moved = np.diff(q, axis=0)
    squares, cubes = 3.0 * moved - 2.0 * begins - ends, begins + ends - 2.0 * moved
    place = q[:-1] + s * begins + s**2 * squares + s**3 * cubes
    return place, begins + 2.0 * s * squares + 3.0 * s**2 * cubes


def within_steps(
    q: np.ndarray, v: np.ndarray, h: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return positions and velocities (steps, nq) at equal parts of each step, ends included.

    q, v: (nodes, nq) [m or rad, m/s or rad/s]; h: (steps,) [s]. Raises ValueError if the shapes do
    not fit.
    """
    h, parts = h[:, None], np.linspace(0.0, 1.0, _POINTS)
    found = [cubic(q, h * v[:-1], h * v[1:], s) for s in parts]
    return [place for place, _ in found], [speed / h for _, speed in found]


def by_convention(points: np.ndarray, replayed: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return the forces (steps, n) [N] of each convention.

    points: (points, steps, n) of the law; replayed: (steps, n) means of the replay, or None. Raises
    ValueError if the shapes do not fit.
    """
    mean = (points[:-1] + points[1:]).mean(axis=0) / 2.0
    middle = points[len(points) // 2]
    forces = {"start": points[0], "middle": middle, "end": points[-1], "mean": mean}
    return forces if replayed is None else {**forces, "mean of the replay": replayed}


def least_slip(slips: np.ndarray) -> np.ndarray:
    """Return the slip (steps, nf) [m/s] of least magnitude of each step, 0 where it reverses.

    slips: (n, steps, nf). Raises ValueError without slips.
    """
    low, high = slips.min(axis=0), slips.max(axis=0)
    return np.where(low * high <= 0.0, 0.0, np.where(np.abs(low) < np.abs(high), low, high))
