"""The softplus chain in Drake for SNOPT, as the paper's authors solved it: linear rows for the time step, contact forces by automatic derivatives."""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Size, Work
from benchmarks.suite.carts import SOFTPLUS_EPS, Numbers, numbers_of


def chain(size: Size, folder: Path) -> Work:
    _solve(numbers_of(Size(3, 5)), SOFTPLUS_EPS[:1])
    carts = numbers_of(size)
    return lambda: _solve(carts, SOFTPLUS_EPS)


def _solve(carts: Numbers, schedule: tuple[float, ...]) -> Mapping[str, Any]:
    n, steps = carts.n, carts.steps
    guess = [
        np.tile(carts.start[:n], (steps, 1)),
        np.tile(carts.start[n:], (steps, 1)),
        np.zeros((steps, 2)),
        np.zeros((steps, n - 1)),
    ]
    result: Any = None
    for eps in schedule:
        program, unknowns = _program(carts, abs(np.log(eps)))
        from pydrake.solvers import SnoptSolver

        for part, values in zip(unknowns, guess, strict=True):
            program.SetInitialGuess(part, values)
        result = SnoptSolver().Solve(program)
        guess = [result.GetSolution(part) for part in unknowns]
    return {
        "outcome": "solved" if result.is_success() else str(result.get_solution_result()),
        "value": float(np.square(guess[2]).sum()),
    }


def _program(carts: Numbers, b: float) -> tuple[Any, tuple[Any, ...]]:
    """The program at sharpness b, and its unknowns q, v (steps, n), u (steps, 2), lam (steps, n-1)."""
    from pydrake.math import exp, log
    from pydrake.solvers import MathematicalProgram

    n, steps, h, m = carts.n, carts.steps, carts.step, carts.mass
    program = MathematicalProgram()
    q, v, u, lam = (
        program.NewContinuousVariables(steps, columns, name)
        for columns, name in ((n, "q"), (n, "v"), (2, "u"), (n - 1, "lam"))
    )
    program.AddBoundingBoxConstraint(-carts.limit, carts.limit, u.flatten())
    program.AddBoundingBoxConstraint(carts.goal[:n], carts.goal[:n], q[-1])
    program.AddBoundingBoxConstraint(carts.goal[n:], carts.goal[n:], v[-1])
    program.AddQuadraticCost(2 * np.eye(u.size), np.zeros(u.size), u.flatten(), is_convex=True)
    # v1 = (1 - h c/m) v0 + h/m (B u + J' lam), q1 = q0 + h v1
    push, contact = np.zeros((n, 2)), np.zeros((n, n - 1))
    push[0, 0] = push[-1, 1] = 1.0
    for index in range(n - 1):
        contact[index, index], contact[index + 1, index] = -1.0, 1.0
    eye, drag = np.eye(n), 1.0 - h * carts.damping / m

    def soft(values: np.ndarray) -> np.ndarray:
        """lam - softplus(penetration), for (q0, lam) of one step: plain numbers, or ones that carry derivatives."""
        before, force = values[:n], values[n:]
        rows = []
        for index in range(n - 1):
            x = b * (carts.length - (before[index + 1] - before[index]))
            positive = x > 0
            rows.append(
                force[index]
                - carts.stiffness / b * (x + log(1 + exp(-x)) if positive else log(1 + exp(x)))
            )
        return np.array(rows)

    at_start = soft(np.concatenate([carts.start[:n], np.zeros(n - 1)]))
    program.AddBoundingBoxConstraint(-at_start, -at_start, lam[0])
    for t in range(steps):
        zero = np.zeros(n)
        if t == 0:
            program.AddLinearEqualityConstraint(
                np.hstack([eye, -h / m * push, -h / m * contact]),
                drag * carts.start[n:],
                np.concatenate([v[0], u[0], lam[0]]),
            )
            program.AddLinearEqualityConstraint(
                np.hstack([eye, -h * eye]), carts.start[:n], np.concatenate([q[0], v[0]])
            )
            continue
        program.AddLinearEqualityConstraint(
            np.hstack([eye, -drag * eye, -h / m * push, -h / m * contact]),
            zero,
            np.concatenate([v[t], v[t - 1], u[t], lam[t]]),
        )
        program.AddLinearEqualityConstraint(
            np.hstack([eye, -eye, -h * eye]), zero, np.concatenate([q[t], q[t - 1], v[t]])
        )
        program.AddConstraint(
            soft, np.zeros(n - 1), np.zeros(n - 1), np.concatenate([q[t - 1], lam[t]])
        )
    return program, (q, v, u, lam)
