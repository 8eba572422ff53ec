"""The equations of the score, one function a metric; arrays in, one number out.

Shapes as in Trajectory and Replay: nodes = steps + 1; phi (steps, nc) is the penetration at the
*start* of each step, where the plan's lam (steps, nc) belongs.

`half_unit` tells how finely numbers are printed: what a plan may be off by without being wrong.

    half_unit(np.round(motion, 4), most=1.0)     # 5e-05: four decimals
    half_unit(motion, most=1.0)                  # 0.0: all the digits of float64
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


def contact_law_error(
    lam: np.ndarray, law: np.ndarray, least: np.ndarray, most: np.ndarray, h: np.ndarray
) -> float:
    """Sum over steps and contacts of h times the distance of lam from what the true law gives over the step.

    Parameters
    ----------
    lam : (steps, nc) planned contact forces [N].
    law : (nodes, nc) of the true law at the nodes [N].
    least, most : (steps, nc) of the true law within each step, on the true motion from its start
        [N].
    h : (steps,) [s].

    Returns
    -------
    [N s]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    low, high = (
        np.minimum(np.minimum(law[:-1], law[1:]), least),
        np.maximum(np.maximum(law[:-1], law[1:]), most),
    )
    return float((h[:, None] * np.maximum(np.maximum(lam - high, low - lam), 0.0)).sum())


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


def friction_violation(friction: np.ndarray, limit: np.ndarray) -> float:
    """Coulomb's law: the largest max(abs(f) - mu N, 0) over steps and frictions.

    Parameters
    ----------
    friction, limit : (steps, nf) f and mu N [N].

    Returns
    -------
    [N]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    return float(np.maximum(np.abs(friction) - limit, 0.0).max(initial=0.0))


def friction_dissipation_error(
    friction: np.ndarray, least: np.ndarray, most: np.ndarray, slip: np.ndarray
) -> np.ndarray:
    """Largest abs of mu N abs(s) + f s, with the mu N in its range that makes it smallest: 0 where it sticks or slips against all of mu N.

    Parameters
    ----------
    friction : (steps, nf) f [N].
    least, most : (steps, nf) range of mu N [N].
    slip : (steps, nf) s [m/s], that of each step's friction.

    Returns
    -------
    (nf,) [W]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    against = -friction * np.sign(slip)
    off = np.maximum(np.maximum(least - against, against - most), 0.0)
    return (off * np.abs(slip)).max(axis=0, initial=0.0)


def friction_impulse_error(
    plan: np.ndarray, step_of: np.ndarray, friction: np.ndarray, duration: np.ndarray
) -> float:
    """Integral over time of abs(f - f_plan), by the trapezoid rule on the pieces of the replay's grid.

    Parameters
    ----------
    plan : (steps, nf) f_plan [N].
    step_of : (n-1,) the plan's step of each piece [-].
    friction : (n, nf) f of the replay [N].
    duration : (n-1,) of each piece [s].

    Returns
    -------
    [N s]

    Raises
    ------
    ValueError, IndexError : if the shapes do not fit.
    """
    planned = plan[step_of]
    return float(
        (
            (np.abs(friction[:-1] - planned) + np.abs(friction[1:] - planned))
            / 2
            * duration[:, None]
        ).sum()
    )


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


# More digits than these are as good as all.
_DIGITS = 12
# A unit of so many decimals at most is taken for one that was chosen.
_FEW = 1e-6
# Rounding of numbers that were read from text or came of a product.
_ROUNDING = 1e-13
# Numbers that would be printed coarser than this share of what counts as large are taken as they
# stand: 2.5 is 2.5, not something near it.
_MOST = 5e-4


def half_unit(values: np.ndarray, most: float) -> float:
    """Half a unit of the last printed digit of some numbers.

    Decimals are looked for over all numbers of a group (the positions, the forces, ..); where there
    are more than six, significant digits: small numbers that are printed with a few of those have
    many decimals.

    Parameters
    ----------
    values : (n,) or (rows, columns) numbers of one kind [any unit].
    most : what counts as large here, in the same unit.

    Returns
    -------
    0 where all digits are given, or so few that they are the number: half a unit would be more than
        5e-4 of `most`.
    """
    sizes = np.abs(values[values != 0.0])
    if not sizes.size:
        return 0.0
    unit = _decimals(sizes)
    half = (unit if unit >= _FEW else max(unit, _significant(sizes))) / 2.0
    return half if half <= _MOST * most else 0.0


def _decimals(sizes: np.ndarray) -> float:
    for digits in range(_DIGITS + 1):
        if (np.abs(sizes - np.round(sizes, digits)) <= _ROUNDING * np.maximum(sizes, 1.0)).all():
            return 10.0**-digits
    return 0.0


def _significant(sizes: np.ndarray) -> float:
    exponents = np.floor(np.log10(sizes))
    for digits in range(1, _DIGITS + 1):
        scaled = sizes * 10.0 ** (digits - 1 - exponents)
        if (np.abs(scaled - np.round(scaled)) <= _ROUNDING * scaled).all():
            return float(10.0 ** (exponents.max() + 1 - digits))
    return 0.0
