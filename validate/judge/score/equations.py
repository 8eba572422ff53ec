"""Equations of the metrics, with the shapes of Trajectory and Replay: nodes = steps + 1.

Penetrations are those at the start of each step, as the plan's lam (steps, nc). Every function
raises ValueError if the shapes do not fit.
"""

from __future__ import annotations

import numpy as np


def physics(lam: np.ndarray, push: np.ndarray) -> float:
    """Return the paper's complementarity violation (10), sum of abs(lam*(lam - push)) [N^2].

    lam: (steps, nc) forces [N]; push: (steps, nc) k*phi, with damping [N]. Raises ValueError.
    """
    return float(np.abs(lam * (lam - push)).sum())


def physics_scaled(
    lam: np.ndarray, push: np.ndarray, k: np.ndarray, length: np.ndarray, h: np.ndarray
) -> float:
    """Return the scaled violation, sum of h*abs(lam*(lam - push))/(k*L)^2 [s], on any grid.

    lam, push: (steps, nc) [N]; k: (nc,) [N/m]; length L: (nc,) nominal penetrations [m]; h:
    (steps,) [s]. Raises ValueError.
    """
    return float((h[:, None] * np.abs(lam * (lam - push)) / (k * length) ** 2).sum())


def defect(q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return the largest residuals of semi-implicit Euler, (2*nq,), positions, then velocities.

    Residuals are abs of q[t+1] - q[t] - h v[t+1] and of v[t+1] - v[t] - h a[t]. Raises ValueError.

    - q, v: (nodes, nq) [m or rad, m/s or rad/s].
    - acceleration: (steps, nq), with the plan's lam.
    - h: (steps,) [s].
    """
    positions = q[1:] - (q[:-1] + h[:, None] * v[1:])
    velocities = v[1:] - (v[:-1] + h[:, None] * acceleration)
    return np.concatenate([np.abs(positions).max(axis=0), np.abs(velocities).max(axis=0)])


def rate_misfit(t: np.ndarray, q: np.ndarray, v: np.ndarray, step: float) -> np.ndarray:
    """Return the distance (nodes - 2, nq) of velocities from the slopes around their row.

    0 between the slopes; t: (nodes,) [s]; q, v: (nodes, nq) [m or rad, m/s or rad/s]; step:
    shortest time of a slope [s]. Raises ValueError.
    """
    inner, slopes = t[1:-1], []
    for h, sign in ((np.diff(t)[:-1], -1.0), (np.diff(t)[1:], 1.0)):
        other = np.clip(inner + sign * np.maximum(h, step), t[0], t[-1])
        moved = np.array([np.interp(other, t, column) for column in q.T]).reshape(q.shape[1], -1).T
        slopes.append((moved - q[1:-1]) / (other - inner)[:, None])
    low, high = np.minimum(*slopes), np.maximum(*slopes)
    return np.maximum(np.maximum(v[1:-1] - high, low - v[1:-1]), 0.0)


def outside(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the largest max(x - upper, lower - x, 0) of each column, (n,) [its unit].

    values: (rows, n); lower, upper: (n,), may be infinite. Raises ValueError.
    """
    return np.maximum(values - upper, lower - values).max(axis=0, initial=0.0)


def largest_difference(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """Return the largest difference of a coordinate [m or rad], and its node.

    one, other: (nodes, nq). Raises ValueError.
    """
    worst = np.abs(one - other).max(axis=1)
    node = int(worst.argmax())
    return float(worst[node]), node


def friction_dissipation_error(
    friction: np.ndarray, least: np.ndarray, most: np.ndarray, slip: np.ndarray
) -> np.ndarray:
    """Return abs of mu N abs(s) + f s (steps, nf) [W], with the best mu N of its range.

    0 while sticking, or slipping against all of mu N. friction f: (steps, nf) [N]; least, most:
    range of mu N [N]; slip s: [m/s]. Raises ValueError.
    """
    against = -friction * np.sign(slip)
    off = np.maximum(np.maximum(least - against, against - most), 0.0)
    return off * np.abs(slip)


def energy_residual(
    energy: np.ndarray, input_work: np.ndarray, dissipated_work: np.ndarray
) -> float:
    """Return the largest abs(E - E(0) - W_in + W_dissipated) [J].

    energy E: (n,), with contact energy; works: (n,) since the start [J]. Raises ValueError.
    """
    return float(np.abs(energy - energy[0] - input_work + dissipated_work).max())
