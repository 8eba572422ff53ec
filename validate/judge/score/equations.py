"""The equations of the score, one function a metric; arrays in, one number out.

Shapes as in Trajectory and Replay: nodes = steps + 1; phi (steps, nc) is the penetration at the
*start* of each step, where the plan's lam (steps, nc) belongs.
"""

from __future__ import annotations

import numpy as np


def physics(lam: np.ndarray, push: np.ndarray) -> float:
    """Complementarity violation of the paper's (10): sum over steps and contacts of abs(lam*(lam - push)).

    Parameters
    ----------
    lam : (steps, nc) contact forces [N].
    push : (steps, nc) what the true force is the positive part of [N]: k*phi without damping.

    Returns
    -------
    [N^2]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return float(np.abs(lam * (lam - push)).sum())


def physics_scaled(
    lam: np.ndarray, push: np.ndarray, k: np.ndarray, length: np.ndarray, h: np.ndarray
) -> float:
    """Complementarity violation, the same on any grid: sum over steps and contacts of h*abs(lam*(lam - push))/(k*L)^2.

    Parameters
    ----------
    lam, push : (steps, nc) as of `physics` [N].
    k : (nc,) stiffness [N/m].
    length : (nc,) L, the contact's nominal penetration [m].
    h : (steps,) [s].

    Returns
    -------
    [s]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return float((h[:, None] * np.abs(lam * (lam - push)) / (k * length) ** 2).sum())


def defect(q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Largest misses of semi-implicit Euler: abs of q[t+1] - q[t] - h v[t+1] and of v[t+1] - v[t] - h a[t].

    Parameters
    ----------
    q, v : (nodes, nq) positions [m or rad], velocities [m/s or rad/s].
    acceleration : (steps, nq) a, with the plan's own lam [m/s^2 or rad/s^2].
    h : (steps,) [s].

    Returns
    -------
    (2*nq,) of the positions, then of the velocities.

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    positions = q[1:] - (q[:-1] + h[:, None] * v[1:])
    velocities = v[1:] - (v[:-1] + h[:, None] * acceleration)
    return np.concatenate([np.abs(positions).max(axis=0), np.abs(velocities).max(axis=0)])


def rate_misfit(t: np.ndarray, q: np.ndarray, v: np.ndarray, step: float) -> np.ndarray:
    """Distance of the velocities from the slopes of the positions before and after their row.

    Parameters
    ----------
    t : (nodes,) [s].
    q, v : (nodes, nq) [m or rad], [m/s or rad/s].
    step : shortest time over which a slope is taken [s].

    Returns
    -------
    (nodes - 2, nq) of the rows between the first and the last, 0 between the two slopes.

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    inner, slopes = t[1:-1], []
    for h, sign in ((np.diff(t)[:-1], -1.0), (np.diff(t)[1:], 1.0)):
        other = np.clip(inner + sign * np.maximum(h, step), t[0], t[-1])
        moved = np.array([np.interp(other, t, column) for column in q.T]).reshape(q.shape[1], -1).T
        slopes.append((moved - q[1:-1]) / (other - inner)[:, None])
    low, high = np.minimum(*slopes), np.maximum(*slopes)
    return np.maximum(np.maximum(v[1:-1] - high, low - v[1:-1]), 0.0)


def outside(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Largest max(x - upper, lower - x, 0) of each column.

    Parameters
    ----------
    values : (rows, n) [unit of each column].
    lower, upper : (n,) bounds [unit of each column], may be infinite.

    Returns
    -------
    (n,) [unit of each column].

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return np.maximum(values - upper, lower - values).max(axis=0, initial=0.0)


def largest_difference(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """Largest abs difference of any one coordinate over the nodes.

    Parameters
    ----------
    one, other : (nodes, nq) positions [m or rad].

    Returns
    -------
    The difference [m or rad], and the node.

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    worst = np.abs(one - other).max(axis=1)
    node = int(worst.argmax())
    return float(worst[node]), node


def excess_impulse(lam: np.ndarray, other: np.ndarray, h: np.ndarray) -> float:
    """Impulse that one has and the other has not: sum over steps and contacts of h max(lam - other, 0).

    Ghost impulse is that of the plan over the largest of the replay's `force_window`, missed
    impulse that of its least over the plan.

    Parameters
    ----------
    lam, other : (steps, nc) contact forces [N].
    h : (steps,) [s].

    Returns
    -------
    [N s]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return float((h[:, None] * np.maximum(lam - other, 0.0)).sum())


def friction_dissipation_error(
    friction: np.ndarray, least: np.ndarray, most: np.ndarray, slip: np.ndarray
) -> np.ndarray:
    """Return abs of mu N abs(s) + f s, with the mu N in its range that makes it smallest: 0 where it sticks or slips against all of mu N.

    Parameters
    ----------
    friction : (steps, nf) f [N].
    least, most : (steps, nf) range of mu N [N].
    slip : (steps, nf) s [m/s], that of each step's friction.

    Returns
    -------
    (steps, nf) [W]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    against = -friction * np.sign(slip)
    off = np.maximum(np.maximum(least - against, against - most), 0.0)
    return off * np.abs(slip)


def energy_residual(
    energy: np.ndarray, input_work: np.ndarray, dissipated_work: np.ndarray
) -> float:
    """Largest abs(E - E(0) - W_in + W_dissipated) over time.

    Parameters
    ----------
    energy : (n,) E, with the energy stored in contacts [J].
    input_work, dissipated_work : (n,) since the start [J].

    Returns
    -------
    [J]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return float(np.abs(energy - energy[0] - input_work + dissipated_work).max())


def energy_turnover(
    kinetic: np.ndarray,
    potential: np.ndarray,
    contact: np.ndarray,
    input_work: np.ndarray,
    dissipated_work: np.ndarray,
) -> float:
    """The largest energy that is there to be turned over: kinetic, in contacts, range of the potential, work in, work dissipated.

    Parameters
    ----------
    kinetic, potential, contact : (n,) energies [J].
    input_work, dissipated_work : (n,) since the start [J].

    Returns
    -------
    [J]

    Raises
    ------
    ValueError : for no rows.
    """
    return float(
        max(
            kinetic.max(),
            contact.max(),
            np.ptp(potential),
            np.abs(input_work).max(),
            np.abs(dissipated_work).max(),
        )
    )
