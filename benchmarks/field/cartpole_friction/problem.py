"""The published cart-pole problem with friction, typed again in CasADi, solved with Ipopt.

    solution = solve(PARAMETERS, Form.PUBLISHED)
    solution.cost, solution.seconds, solution.columns["x"]

The formulation is that of `experiments/ipopt/cartpole_friction.jl` and `experiments/models/cartpole.jl`
of InteriorPointDDP.jl (README.md beside this file names the commit): the same unknowns, bounds,
first guess and options of Ipopt. `Form.CORRECTED` counts the Coriolis terms once.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

STEP = 0.05  # [s]
STEPS = 100
GRAVITY = 9.81  # [m/s^2]
LIMIT = 10.0  # largest force on the cart [N]
GOAL = (0.0, np.pi)  # place of the cart [m], angle of the pole from hanging [rad]
_OPTIONS = {
    "max_iter": 1000,
    "nlp_scaling_method": "none",
    "tol": 1e-7,
    "max_soc": 0,
    "max_filter_resets": 0,
    "max_resto_iter": 0,
    "print_level": 0,
    "sb": "yes",
}
# Unknowns of a step: the force, the next positions, two friction impulses each way, their
# multipliers, and slacks of the complementarity conditions.
_SIZES = {"force": 1, "q": 2, "beta": 4, "eta": 4, "psi": 2, "s": 2, "slack": 6}
PARAMETERS = ("m_c", "m_p", "l", "mu_rail", "mu_hinge")
_SIGNED = ("force", "q")
_FIRST = 0.01  # first guess of every unknown that has no sign to choose


class Form(Enum):
    """Which momentum step the plan solves."""

    PUBLISHED = "published"
    CORRECTED = "corrected"


@dataclass(frozen=True)
class Solved:
    """A plan of the published problem.

    cost: objective of the published problem [-]; columns: (STEPS + 1,) of t [s], x [m], theta
    [rad], vx [m/s], omega [rad/s], u [N], friction_rail [N], friction_hinge [N]; the last row of
    the inputs and forces repeats the row before.
    """

    success: bool
    status: str
    cost: float
    iterations: int
    seconds: float
    columns: Mapping[str, np.ndarray]


def momentum_rows(form: Form, p, q, v, q_next, v_next):
    """Return M v of the next node minus M v of this node plus h times the forces without inputs.

    The published step adds C v, which already is in the difference of M v. The corrected step adds
    -dT/dq, the rest of Lagrange's equations.
    """
    import casadi as ca

    def mass(angle):
        coupling = p["m_p"] * p["l"] * ca.cos(angle)
        return coupling, p["m_p"] * p["l"] ** 2

    def momentum(q, v):
        coupling, inertia = mass(q[1])
        return ca.vertcat(
            (p["m_c"] + p["m_p"]) * v[0] + coupling * v[1], coupling * v[0] + inertia * v[1]
        )

    def forces(q, v):
        moment = p["m_p"] * p["l"] * ca.sin(q[1])
        gravity = moment * p["g"]
        if form is Form.PUBLISHED:
            return ca.vertcat(-moment * v[1] ** 2, gravity)
        return ca.vertcat(0, moment * v[0] * v[1] + gravity)

    return (
        momentum(q_next, v_next)
        - momentum(q, v)
        + STEP / 2 * (forces(q_next, v_next) + forces(q, v))
    )


def solve(parameters: Mapping[str, float], form: Form) -> Solved:
    """Solve one instance from the published first guess."""
    import casadi as ca

    p = {"g": GRAVITY, **parameters}
    states = [ca.MX.sym(f"x_{k}", 4) for k in range(STEPS + 1)]
    steps = [
        {name: ca.MX.sym(f"{name}_{k}", size) for name, size in _SIZES.items()}
        for k in range(STEPS)
    ]
    rail = p["mu_rail"] * (p["m_c"] + p["m_p"]) * p["g"]
    hinge = p["mu_hinge"] * p["m_p"] * p["g"] * p["l"]
    rows, cost, middles = [states[0]], 0, [(ca.MX.zeros(2), ca.MX.zeros(2))]
    for step, state, following in zip(steps, states, states[1:], strict=False):
        before, now, after = state[:2], state[2:], step["q"]
        beta, eta, slack = step["beta"], step["eta"], step["slack"]
        v, v_next = (now - before) / STEP, (after - now) / STEP
        q, q_next = (before + now) / 2, (now + after) / 2
        friction = ca.vertcat(beta[0] - beta[1], beta[2] - beta[3])
        driven = ca.vertcat(step["force"][0], 0) + friction
        rows += [
            following - ca.vertcat(now, after),
            momentum_rows(form, p, q, v, q_next, v_next) - STEP * driven,
            ca.vertcat(v_next[0], -v_next[0]) + step["psi"][0] - eta[:2],
            ca.vertcat(v_next[1], -v_next[1]) + step["psi"][1] - eta[2:],
            rail - beta[0] - beta[1] - step["s"][0],
            hinge - beta[2] - beta[3] - step["s"][1],
            step["psi"] * step["s"] - slack[:2],
            beta * eta - slack[2:],
        ]
        cost += 0.01 * STEP * step["force"] ** 2 + 2.0 * ca.sum1(slack)
        middles.append((q_next, v_next))
    last, end = (states[-1][2:] - states[-1][:2]) / STEP, states[-1][2:]
    cost += 200.0 * ca.sumsqr(last) + 700.0 * ca.sumsqr(end - ca.DM(GOAL))
    free = [-np.inf] * (4 * len(states))
    unknowns = ca.vertcat(*states, *(step[name] for step in steps for name in _SIZES))
    nlp = {"x": unknowns, "f": cost, "g": ca.vertcat(*rows)}
    began = time.process_time()
    solver = ca.nlpsol(
        "cartpole",
        "ipopt",
        nlp,
        {"ipopt": _OPTIONS, "print_time": False, "error_on_fail": False, "expand": True},
    )
    lower = free + [
        {"force": -LIMIT, "q": -np.inf}.get(name, 0.0)
        for _ in steps
        for name, size in _SIZES.items()
        for _ in range(size)
    ]
    upper = [np.inf] * len(free) + [
        LIMIT if name == "force" else np.inf
        for _ in steps
        for name, size in _SIZES.items()
        for _ in range(size)
    ]
    guess = [0.0] * len(free) + [
        0.0 if name in _SIGNED else _FIRST
        for _ in steps
        for name, size in _SIZES.items()
        for _ in range(size)
    ]
    answer = solver(x0=guess, lbx=lower, ubx=upper, lbg=0, ubg=0)
    seconds = time.process_time() - began
    read = ca.Function(
        "read",
        [unknowns],
        [
            ca.horzcat(*(ca.vertcat(*pair) for pair in middles)),
            ca.horzcat(*(step["force"] for step in steps)),
            ca.horzcat(*(step["beta"] for step in steps)),
        ],
    )
    motion, force, beta = (np.asarray(part, dtype=float) for part in read(answer["x"]))
    stats = solver.stats()
    held = np.vstack([force[0], beta[0] - beta[1], (beta[2] - beta[3]) / p["l"]])
    held = np.hstack([held, held[:, -1:]])
    names = ("x", "theta", "vx", "omega")
    columns = {"t": STEP * np.arange(STEPS + 1), **dict(zip(names, motion, strict=True))}
    columns |= dict(zip(("u", "friction_rail", "friction_hinge"), held, strict=True))
    return Solved(
        success=bool(stats["success"]),
        status=str(stats["return_status"]),
        cost=float(answer["f"]),
        iterations=int(stats["iter_count"]),
        seconds=seconds,
        columns=columns,
    )
