"""One MPEC in CasADi's symbols, as every peer gets it: min f, rows within limits, 0 <= first complementary to second >= 0.

Two sources: the three carts, written by hand from the paper's equations, and any Pyomo model with
Complementarity components (by walking its expressions). Exact sparse derivatives of all of it are
CasADi's.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.mpec.judge import DAMPING, GOAL, INPUT_LIMIT, LENGTH, START, STEP, STEPS, STIFFNESS


@dataclass(frozen=True, kw_only=True)
class Program:
    """x (n,) with bounds and a start; rows (m,) with limits; first, second: the sides of the pairs.

    names: of x, for the judge.
    """

    x: ca.SX
    objective: ca.SX
    rows: ca.SX
    first: ca.SX
    second: ca.SX
    lower: np.ndarray
    upper: np.ndarray
    rows_lower: np.ndarray
    rows_upper: np.ndarray
    start: np.ndarray


def three_cart(start: dict[str, np.ndarray]) -> Program:
    """Strict complementarity on the paper's grid: semi-implicit Euler, force and damping at the start of a step, exact terminal state."""
    q, v, u, lam = (
        ca.SX.sym(name, rows, STEPS) for name, rows in (("q", 3), ("v", 3), ("u", 2), ("lam", 2))
    )
    q_all = ca.horzcat(ca.DM(START[:3]), q)
    v_all = ca.horzcat(ca.DM(START[3:]), v)
    before_q, before_v = q_all[:, :-1], v_all[:, :-1]
    force = (
        ca.vertcat(u[0, :] - lam[0, :], lam[0, :] - lam[1, :], u[1, :] + lam[1, :])
        - DAMPING * before_v
    )
    rows = ca.vertcat(ca.vec(q - before_q - STEP * v), ca.vec(v - before_v - STEP * force))
    penetration = LENGTH - ca.vertcat(
        before_q[1, :] - before_q[0, :], before_q[2, :] - before_q[1, :]
    )
    x = ca.vertcat(*(ca.vec(part) for part in (q, v, u, lam)))
    free = np.full(6 * STEPS, np.inf)
    lower = np.concatenate([-free, np.full(2 * STEPS, -INPUT_LIMIT), np.zeros(2 * STEPS)])
    upper = np.concatenate([free, np.full(2 * STEPS, INPUT_LIMIT), np.full(2 * STEPS, np.inf)])
    for block, goal in (
        (slice(3 * STEPS - 3, 3 * STEPS), GOAL[:3]),
        (slice(6 * STEPS - 3, 6 * STEPS), GOAL[3:]),
    ):
        lower[block] = upper[block] = goal
    zero = np.zeros(rows.shape[0])
    return Program(
        x=x, objective=ca.sumsqr(u), rows=rows, first=ca.vec(lam),
        second=ca.vec(lam - STIFFNESS * penetration),
        lower=lower, upper=upper, rows_lower=zero, rows_upper=zero,
        start=np.concatenate([start["q"][1:].ravel(), start["v"][1:].ravel(), start["u"].ravel(),
                              start["lam"].ravel()]),
    )  # fmt: skip


def plan_of(x: np.ndarray) -> dict[str, np.ndarray]:
    """A point of `three_cart` as the judge wants it."""
    q, v, u, lam = np.split(x, np.cumsum([3 * STEPS, 3 * STEPS, 2 * STEPS]))
    return {
        "q": np.vstack([START[:3], q.reshape(STEPS, 3)]),
        "v": np.vstack([START[3:], v.reshape(STEPS, 3)]),
        "u": u.reshape(STEPS, 2), "lam": lam.reshape(STEPS, 2),
    }  # fmt: skip


def of_pyomo(model: Any) -> tuple[Program, list[Any]]:
    """(program, its Pyomo variables) of a model whose conditions have one bound on each side."""
    import pyomo.environ as pyo
    from pyomo.core.expr.visitor import identify_variables
    from pyomo.mpec import Complementarity

    constraints = list(model.component_data_objects(pyo.Constraint, active=True))
    conditions = [
        data._canonical_expression(side)
        for data in model.component_data_objects(Complementarity, active=True)
        for side in data._args
    ]
    if any(len(side) != 3 or (side[0] is None) == (side[2] is None) for side in conditions):
        raise NotImplementedError(
            "a condition that is not 'expression with one bound' on both sides"
        )
    objective = next(model.component_data_objects(pyo.Objective, active=True))
    known: dict[int, Any] = {}
    for expression in (
        objective.expr,
        *(row.body for row in constraints),
        *(side[1] for side in conditions),
    ):
        known.update(
            (id(variable), variable)
            for variable in identify_variables(expression, include_fixed=False)
        )
    variables = list(known.values())
    x = ca.SX.sym("x", len(variables))
    symbols = {name: x[k] for k, name in enumerate(known)}
    sides = [
        body - pyo.value(low) if high is None else pyo.value(high) - body
        for low, body, high in conditions
    ]
    walked = [_walk(side, symbols) for side in sides]
    limits = [(row.lb, row.ub) for row in constraints]
    return Program(
        x=x,
        objective=(1 if objective.sense == pyo.minimize else -1) * _walk(objective.expr, symbols),
        rows=ca.vertcat(*(_walk(row.body, symbols) for row in constraints)),
        first=ca.vertcat(*walked[::2]), second=ca.vertcat(*walked[1::2]),
        lower=np.array([-np.inf if v.lb is None else v.lb for v in variables]),
        upper=np.array([np.inf if v.ub is None else v.ub for v in variables]),
        rows_lower=np.array([-np.inf if low is None else low for low, _ in limits]),
        rows_upper=np.array([np.inf if high is None else high for _, high in limits]),
        start=np.array([0.0 if v.value is None else v.value for v in variables], dtype=float),
    ), variables  # fmt: skip


def _walk(node: Any, symbols: dict[int, ca.SX]) -> Any:
    """A Pyomo expression in CasADi's symbols; expressions of these problems are shallow."""
    import pyomo.environ as pyo

    if id(node) in symbols:
        return symbols[id(node)]
    if not hasattr(node, "is_expression_type") or not node.is_expression_type():
        return pyo.value(node)
    operands = [_walk(argument, symbols) for argument in node.args]
    if hasattr(node, "getname") and hasattr(ca, node.getname()) and len(operands) == 1:
        return getattr(ca, node.getname())(operands[0])
    return node._apply_operation(operands)
