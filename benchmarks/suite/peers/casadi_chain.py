"""The softplus chain written by hand in CasADi for Ipopt: one program with the sharpness as a parameter, solved three times.

Symbols are whole matrices, the time step is one vectorised expression, derivatives are exact and
sparse; duals go from step to step where that helps, as ours do.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Size, Work
from benchmarks.suite.carts import SOFTPLUS_EPS, Numbers, numbers_of

_IPOPT = {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 3000}
_WARM = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-6,
    **{
        f"warm_start_{name}": 1e-9
        for name in (
            "bound_push",
            "bound_frac",
            "slack_bound_push",
            "slack_bound_frac",
            "mult_bound_push",
        )
    },
}
# Stages at this eps or below take multipliers too.
_DUALS_FROM = 1e-4


def chain(size: Size, folder: Path) -> Work:
    _solve(numbers_of(Size(3, 5)), SOFTPLUS_EPS[:1])
    carts = numbers_of(size)
    return lambda: _solve(carts, SOFTPLUS_EPS)


def cold_step(size: Size, folder: Path) -> Work:
    _solve(numbers_of(Size(3, 5)), SOFTPLUS_EPS[:1])
    carts = numbers_of(size)
    return lambda: _solve(carts, SOFTPLUS_EPS[-1:])


def _solve(carts: Numbers, schedule: tuple[float, ...]) -> Mapping[str, Any]:
    import casadi as ca

    n, steps, h = carts.n, carts.steps, carts.step
    q, v, u, lam = (
        ca.SX.sym(name, rows, steps)
        for name, rows in (("q", n), ("v", n), ("u", 2), ("lam", n - 1))
    )
    b = ca.SX.sym("b")
    before_q, before_v = (
        ca.horzcat(ca.DM(carts.start[:n]), q[:, :-1]),
        ca.horzcat(ca.DM(carts.start[n:]), v[:, :-1]),
    )
    force = -carts.damping * before_v
    force[0, :] += u[0, :]
    force[n - 1, :] += u[1, :]
    force[: n - 1, :] -= lam
    force[1:, :] += lam
    penetration = carts.length - (before_q[1:, :] - before_q[: n - 1, :])
    soft = (
        (ca.fmax(b * penetration, 0) + ca.log1p(ca.exp(-ca.fabs(b * penetration))))
        * carts.stiffness
        / b
    )
    rows = ca.vertcat(
        ca.vec(q - before_q - h * v),
        ca.vec(v - before_v - h / carts.mass * force),
        ca.vec(lam - soft),
    )
    x = ca.vertcat(*(ca.vec(part) for part in (q, v, u, lam)))
    nlp = {"x": x, "f": ca.sumsqr(u), "g": rows, "p": b}
    lower, upper, guess = _bounds_and_guess(carts)
    options = {"cold": _IPOPT, "warm": {**_IPOPT, **_WARM}}
    built = {}
    answer: Any = None
    good, iterations = True, 0
    for eps in schedule:
        start: dict[str, Any] = {"x0": guess}
        kind = "cold"
        if answer is not None:
            start = {"x0": answer["x"]}
            if eps < _DUALS_FROM and good:
                kind, start = (
                    "warm",
                    {"x0": answer["x"], "lam_x0": answer["lam_x"], "lam_g0": answer["lam_g"]},
                )
        if kind not in built:
            built[kind] = ca.nlpsol(
                kind,
                "ipopt",
                nlp,
                {"ipopt": options[kind], "print_time": False, "error_on_fail": False},
            )
        answer = built[kind](lbx=lower, ubx=upper, lbg=0, ubg=0, p=abs(np.log(eps)), **start)
        stats = built[kind].stats()
        good, iterations = bool(stats["success"]), iterations + int(stats["iter_count"])
    outcome = "solved" if good else str(stats["return_status"])
    return {"outcome": outcome, "iterations": iterations, "value": float(answer["f"])}


def _bounds_and_guess(carts: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of (q, v, u, lam) by columns: the goal is met exactly.

    The first guess is the start held, u = lam = 0.
    """
    n, steps = carts.n, carts.steps
    states, inputs, forces = n * steps, 2 * steps, (n - 1) * steps
    free = np.full(states, np.inf)
    lower = np.concatenate([-free, -free, np.full(inputs, -carts.limit), np.full(forces, -np.inf)])
    upper = -lower
    for last, goal in ((states, carts.goal[:n]), (2 * states, carts.goal[n:])):
        lower[last - n : last] = upper[last - n : last] = goal
    guess = np.concatenate(
        [
            np.tile(carts.start[:n], steps),
            np.tile(carts.start[n:], steps),
            np.zeros(inputs + forces),
        ]
    )
    return lower, upper, guess
