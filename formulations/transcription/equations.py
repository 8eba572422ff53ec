"""The equations of the transcription: one function per equation, of given quantities.

Semi-implicit Euler in the paper's indices: contact force and damping are at the *start* of a
step, the new position uses the new velocity. Stage equations are those of collocation
(models.schemes). Units: q [m, rad], v [m/s, rad/s], h [s], forces [N, N m], k [N/m], phi [m]
(positive in contact), b [1/m].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import complements


def constraint_position_step(q_next: Any, q_now: Any, v_next: Any, h: Any) -> Any:
    """q[t+1] = q[t] + h v[t+1]   [m, rad]."""
    return q_next == q_now + h * v_next


def constraint_velocity_step(
    mass_row: Sequence[Any], v_next: Sequence[Any], v_now: Sequence[Any], force: Any, h: Any
) -> Any:
    """sum_j M_ij(q[t]) (v_j[t+1] - v_j[t]) = h (tau_i + (J(q[t])' lam[t])_i)   [N s, N m s].

    The mass matrix is not inverted; its zero entries are left out.
    """
    momentum = sum(
        mass * (after - before)
        for mass, after, before in zip(mass_row, v_next, v_now, strict=True)
        if not _is_zero(mass)
    )
    return momentum == h * force


def constraint_position_stage(gained: Any, v_stage: Any, h: Any) -> Any:
    """sum_j D_ij (Q_j - q[t]) = h V_i   [m, rad],   D = A^-1 of the scheme's tableau."""
    return gained == h * v_stage


def constraint_velocity_stage(
    mass_row: Sequence[Any], gained: Sequence[Any], force: Any, h: Any
) -> Any:
    """sum_k M_ik(Q_i) sum_j D_ij (V_j - v[t])_k = h (tau(Q_i, V_i, u) + J(Q_i)' lam_i)   [N s]."""
    return (
        sum(
            mass * change
            for mass, change in zip(mass_row, gained, strict=True)
            if not _is_zero(mass)
        )
        == h * force
    )


def constraint_step_end(x_next: Any, x_now: Any, x_stage: Any) -> Any:
    """x[t+1] = x[t] + 2 (X - x[t]): the stage of the implicit midpoint is mid-step."""
    return x_next == x_now + 2.0 * (x_stage - x_now)


def constraint_contact_softplus(lam: Any, phi: Any, k: Any, b: Any) -> Any:
    """lam[t] = (k / b) log(1 + exp(b phi(q[t])))   [N],   b = |ln eps| / L.

    Paper, eq. 5, sign corrected.
    """
    return lam == (k / b) * pyo.log(1 + pyo.exp(b * phi))


def expression_kelvin_voigt_softplus(phi: Any, rate: Any, k: Any, c: Any, b: Any) -> Any:
    """(k / b) log(1 + exp(b (phi + w c r / k))),  w = 1 / (1 + exp(-b phi))   [N].

    r [m/s] is the rate of phi, c [N s/m].
    """
    return (k / b) * pyo.log(1 + pyo.exp(b * (phi + c * rate / (k * (1 + pyo.exp(-b * phi))))))


def expression_hunt_crossley_softplus(
    phi: Any, rate: Any, k: Any, c: Any, b: Any, length: float
) -> Any:
    """(k / b) log(1 + exp(b phi)) log(1 + exp(b L (1 + c r))) / log(1 + exp(b L))   [N].

    r [m/s] is the rate of phi, c [s/m], L the scene's length [m].
    """
    bl = b * length
    return (
        (k / b)
        * pyo.log(1 + pyo.exp(b * phi))
        * pyo.log(1 + pyo.exp(bl * (1 + c * rate)))
        / pyo.log(1 + pyo.exp(bl))
    )


def expression_kelvin_voigt(spring: Any, touch: Any, c: Any, rate: Any) -> Any:
    """Push sigma + c w r [N] of a contact with Kelvin-Voigt damping."""
    return spring + c * touch * rate


def expression_hunt_crossley(spring: Any, c: Any, rate: Any) -> Any:
    """Push sigma (1 + c r) [N] of a contact with Hunt-Crossley damping."""
    return spring * (1 + c * rate)


def complementarity_contact(lam: Any, push: Any) -> Any:
    """0 <= lam[t]  complements  lam[t] - push >= 0   [N].

    push = k phi(q[t]) without damping (paper, eq. 7). The separation force comes first: Pyomo gives
    the first expression a variable `v`, so that the product is lam * v. The other order would copy
    lam.
    """
    return complements(lam - push >= 0, lam >= 0)


def constraint_friction_regularised(f: Any, limit: Any, slip: Any, steepness: Any) -> Any:
    """f[t] = -mu N tanh(steepness s(q[t], v[t+1]))   [N],   steepness = b / (2 nominal) [s/m]."""
    return f == -limit * pyo.tanh(steepness * slip)


def constraint_slip(forward: Any, backward: Any, slip: Any) -> Any:
    """The slip: forward - backward = s(q[t], v[t+1])   [m/s]."""
    return forward - backward == slip


def complementarity_reserve(variable: Any, reserve: Any) -> Any:
    """0 <= variable  complements  reserve >= 0: slip [m/s] and mu N -+ f [N]; springs, switches."""
    return complements(reserve >= 0, variable >= 0)


def expression_cost(costs: Sequence[Any]) -> Any:
    """Sum of the running cost over t = 0..T-1, not weighted by h (paper: sum_t u1^2 + u3^2 [N^2]).

    The final cost, if any, is added.
    """
    return sum(costs)


def _is_zero(entry: Any) -> bool:
    return entry.__class__ in (int, float) and entry == 0
