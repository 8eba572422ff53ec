"""A Pyomo MPEC solved by CasADi and Ipopt, as a good user writes it by hand: Scholtes' products <= eps, ever smaller.

    program, variables = of_pyomo(model)
    x = casadi_scholtes(program)  # values of the variables

Derivatives are CasADi's, exact and sparse.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

# From 1e-9 on Ipopt is asked for more than its usual 1e-8: a product <= 1e-12 says nothing where
# rows may be off by 1e-8.
_EPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
_TIGHT_EPS = (1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "bound_relax_factor": 0.0,
    "max_iter": 3000,
    "mu_strategy": "monotone",
}
_WARM = {"warm_start_init_point": "yes", "mu_init": 1e-6,
         **{f"warm_start_{name}": 1e-9 for name in (
    "bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")}}  # fmt: skip
_TIGHT = {"tol": 1e-11, "constr_viol_tol": 1e-11, "compl_inf_tol": 1e-11, "mu_init": 1e-11}


@dataclass(frozen=True, kw_only=True)
class Program:
    """min objective, rows (m,) within limits, 0 <= first complementary to second >= 0; x (n,) with bounds and a start."""

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


def casadi_scholtes(program: Program) -> np.ndarray:
    """Return the point (n,) of the last step that Ipopt solved.

    eps is a parameter. Steps have primal-dual warm starts, the last ones tighter tolerances.
    """
    eps = ca.SX.sym("eps")
    nlp = {
        "x": program.x, "f": program.objective, "p": eps,
        "g": ca.vertcat(program.rows, program.first, program.second,
                        program.first * program.second),
    }  # fmt: skip
    pairs = program.first.shape[0]
    limits = {
        "lbx": program.lower, "ubx": program.upper,
        "lbg": np.concatenate([program.rows_lower, np.zeros(2 * pairs), np.full(pairs, -np.inf)]),
    }  # fmt: skip
    options = {"cold": _IPOPT, "warm": {**_IPOPT, **_WARM}, "tight": {**_IPOPT, **_WARM, **_TIGHT}}
    built: dict[str, Any] = {}

    def step(name: str, value: float, **start: Any) -> tuple[Any, bool]:
        if name not in built:
            built[name] = ca.nlpsol(
                name,
                "ipopt",
                nlp,
                {"ipopt": options[name], "print_time": False, "error_on_fail": False},
            )
        upper = np.concatenate(
            [program.rows_upper, np.full(2 * pairs, np.inf), np.full(pairs, value)]
        )
        return built[name](p=value, ubg=upper, **limits, **start), built[name].stats()["success"]

    answer: Any = None
    for value in (*_EPS, *_TIGHT_EPS):
        if answer is None:
            told, good = step("cold", value, x0=program.start)
        else:
            told, good = step(
                "tight" if value in _TIGHT_EPS else "warm",
                value,
                x0=answer["x"],
                lam_x0=answer["lam_x"],
                lam_g0=answer["lam_g"],
            )
            if not good and value in _EPS:  # misled by multipliers: once more without them
                told, good = step("cold", value, x0=answer["x"])
        if not good and answer is not None:
            break
        answer = told
    return np.array(answer["x"]).ravel()
