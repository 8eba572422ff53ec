"""The equations of the score, one function a figure; arrays in, one number out.

Shapes as in Trajectory and Replay: nodes = steps + 1; phi (steps, nc) is the penetration at the *start* of each step,
where the plan's lam (steps, nc) belongs.
"""

from __future__ import annotations

import numpy as np


def physics(lam: np.ndarray, push: np.ndarray) -> float:
    """Sum over steps and contacts of abs(lam*(lam - push)) [N^2], push (steps, nc) = k*phi without damping: the paper's (10)."""
    return float(np.abs(lam * (lam - push)).sum())


def physics_scaled(lam: np.ndarray, push: np.ndarray, k: np.ndarray, length: np.ndarray, h: np.ndarray) -> float:
    """Sum over steps and contacts of h*abs(lam*(lam - push))/(k*L)^2 [s]; L (nc,) [m] the contact's nominal penetration, h (steps,) [s]."""
    return float((h[:, None] * np.abs(lam * (lam - push)) / (k * length) ** 2).sum())


def defect(q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, h: np.ndarray) -> float:
    """max abs of q[t+1] - q[t] - h v[t+1] and v[t+1] - v[t] - h a[t], with a from the plan's own lam [m or rad, and per second]."""
    positions = q[1:] - (q[:-1] + h[:, None] * v[1:])
    velocities = v[1:] - (v[:-1] + h[:, None] * acceleration)
    return float(max(np.abs(positions).max(), np.abs(velocities).max()))


def distance(state: np.ndarray, goal: np.ndarray) -> float:
    """Euclidean norm of state - goal, over whatever components are given; a goal of NaN is free."""
    return float(np.linalg.norm(np.where(np.isnan(goal), 0.0, state - goal)))


def bound_violation(u: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Largest max(u - upper, lower - u, 0) over steps and inputs [N or N m]."""
    return float(np.maximum(u - upper, lower - u).max(initial=0.0))


def velocity_bound_violation(v: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Largest max(v - upper, lower - v, 0) over the starts of the steps, v (nodes, nq) [m/s or rad/s]."""
    return float(np.maximum(v[:-1] - upper, lower - v[:-1]).max(initial=0.0))


def largest_difference(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """Largest abs difference of any one coordinate over the nodes, and the node."""
    worst = np.abs(one - other).max(axis=1)
    node = int(worst.argmax())
    return float(worst[node]), node


def ghost_impulse(plan_lam: np.ndarray, step_of: np.ndarray, gap: np.ndarray, duration: np.ndarray, shift: float = 0.0) -> float:
    """Sum of plan_lam*dt over the pieces of time on which the replay's gap is open [N s].

    Pieces (n-1): plan_lam[step_of] the force the plan holds there, gap (n, nc) at their ends. A piece does not cross an event,
    so the end that is farther from zero tells its side. shift: the same with every gap wider by `shift` [m].
    """
    first, last = gap[:-1] + shift, gap[1:] + shift
    side = np.where(np.abs(first) > np.abs(last), first, last)
    return float((plan_lam[step_of] * (side > 0) * duration[:, None]).sum())


def missed_impulse(plan_lam: np.ndarray, step_of: np.ndarray, lam: np.ndarray, duration: np.ndarray) -> float:
    """Integral of max(lam - plan_lam, 0) [N s], lam (n, nc) of the replay, by the trapezoid rule on its pieces."""
    planned = plan_lam[step_of]
    excess = np.maximum(lam[:-1] - planned, 0.0) + np.maximum(lam[1:] - planned, 0.0)
    return float((excess / 2 * duration[:, None]).sum())


def friction_violation(friction: np.ndarray, limit: np.ndarray) -> float:
    """max(abs(f) - mu N, 0) over steps and frictions [N]; friction, limit (steps, nf)."""
    return float(np.maximum(np.abs(friction) - limit, 0.0).max(initial=0.0))


def friction_dissipation_error(friction: np.ndarray, limit: np.ndarray, slip: np.ndarray) -> float:
    """max abs of mu N abs(s) + f s [W]: 0 where it sticks or slips against all of mu N; slip (steps, nf) at the end of each step."""
    return float(np.abs(limit * np.abs(slip) + friction * slip).max(initial=0.0))


def friction_impulse_error(plan: np.ndarray, step_of: np.ndarray, friction: np.ndarray, duration: np.ndarray) -> float:
    """Integral over time of abs(f - f_plan) [N s], friction (n, nf) of the replay, by the trapezoid rule on its pieces."""
    planned = plan[step_of]
    return float(((np.abs(friction[:-1] - planned) + np.abs(friction[1:] - planned)) / 2 * duration[:, None]).sum())


def max_penetration(gap: np.ndarray) -> float:
    """max(-gap, 0) over time and contacts [m]."""
    return float(np.maximum(-gap, 0.0).max(initial=0.0))


def energy_residual(energy: np.ndarray, input_work: np.ndarray, dissipated_work: np.ndarray) -> float:
    """max over time of abs(E - E(0) - W_in + W_dissipated) [J]; E with the energy stored in contacts."""
    return float(np.abs(energy - energy[0] - input_work + dissipated_work).max())


def energy_turnover(energy: np.ndarray, input_work: np.ndarray, dissipated_work: np.ndarray) -> float:
    """The largest of the terms of the energy balance [J]: what a residual is relative to."""
    terms = (energy - energy[0], input_work, dissipated_work)
    return float(max(np.abs(term).max() for term in terms))
