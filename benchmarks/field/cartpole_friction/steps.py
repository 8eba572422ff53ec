"""The momentum step of the cart-pole with friction, as published and corrected, as Python functions.

    python -m validate energy benchmarks/field/cartpole_friction/scene.py --step benchmarks/field/cartpole_friction/steps.py:published

A state here is the middle of two published positions and their difference over the step:
(q_k-1 + q_k)/2 and (q_k - q_k-1)/h.
"""

import numpy as np
from scipy.optimize import root


def published(q, v, u, h, parameters):
    """Return the state after a step that adds C v to the difference of M v."""
    return _step(_published_forces, q, v, u, h, parameters)


def corrected(q, v, u, h, parameters):
    """Return the state after a step that adds -dT/dq to the difference of M v."""
    return _step(_corrected_forces, q, v, u, h, parameters)


def _published_forces(q, v, p):
    moment = p["m_p"] * p["l"] * np.sin(q[1])
    return np.array([-moment * v[1] ** 2, moment * p["g"]])


def _corrected_forces(q, v, p):
    moment = p["m_p"] * p["l"] * np.sin(q[1])
    return np.array([0.0, moment * v[0] * v[1] + moment * p["g"]])


def _momentum(q, v, p):
    coupling = p["m_p"] * p["l"] * np.cos(q[1])
    inertia = p["m_p"] * p["l"] ** 2
    return np.array(
        [(p["m_c"] + p["m_p"]) * v[0] + coupling * v[1], coupling * v[0] + inertia * v[1]]
    )


def _step(forces, q, v, u, h, p):
    push = np.array([u[0] + p["friction_rail"], p["l"] * p["friction_hinge"]])
    before = _momentum(q, v, p) - h / 2 * forces(q, v, p) + h * push

    def residual(v_next):
        q_next = q + h / 2 * (v + v_next)
        return _momentum(q_next, v_next, p) + h / 2 * forces(q_next, v_next, p) - before

    # From v itself SciPy stalls where the cart rests and the push begins.
    mass = np.column_stack([_momentum(q, unit, p) for unit in np.eye(2)])
    solution = root(residual, np.linalg.solve(mass, before - h / 2 * forces(q, v, p)), tol=1e-13)
    if np.abs(solution.fun).max() > 1e-9 * (1.0 + np.abs(before).max()):
        raise ArithmeticError(f"the momentum step from q = {q}, v = {v} was not solved.")
    return q + h / 2 * (v + solution.x), solution.x
