"""Peers that are given derivatives or symbols: each takes a program, tells `note` every point it believes on its way, and hands back the last."""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# From 1e-9 on Ipopt is asked for more than its usual 1e-8: a product <= 1e-12 says nothing where rows may be off by 1e-8.
_EPS, _TIGHT_EPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8), (1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_IPOPT = {"print_level": 0, "sb": "yes", "bound_relax_factor": 0.0, "max_iter": 3000, "mu_strategy": "monotone"}
_WARM = {"warm_start_init_point": "yes", "mu_init": 1e-6, **{f"warm_start_{name}": 1e-9 for name in (
    "bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")}}  # fmt: skip
_TIGHT = {"tol": 1e-11, "constr_viol_tol": 1e-11, "compl_inf_tol": 1e-11, "mu_init": 1e-11}
Note = Callable[[np.ndarray], None]


def casadi_scholtes(program: Any, note: Note) -> np.ndarray:
    """What a good user writes: products <= eps as a parameter, exact sparse Hessian, primal-dual warm starts from step to step, tighter
    tolerances for the last steps. A step that fails is not believed: the last good point is the answer."""
    import casadi as ca

    eps = ca.SX.sym("eps")
    nlp = {
        "x": program.x, "f": program.objective, "p": eps,
        "g": ca.vertcat(program.rows, program.first, program.second, program.first * program.second),
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
            built[name] = ca.nlpsol(name, "ipopt", nlp, {"ipopt": options[name], "print_time": False, "error_on_fail": False})
        upper = np.concatenate([program.rows_upper, np.full(2 * pairs, np.inf), np.full(pairs, value)])
        return built[name](p=value, ubg=upper, **limits, **start), built[name].stats()["success"]

    answer: Any = None
    for value in (*_EPS, *_TIGHT_EPS):
        if answer is None:
            told, good = step("cold", value, x0=program.start)
        else:
            told, good = step(
                "tight" if value in _TIGHT_EPS else "warm", value, x0=answer["x"], lam_x0=answer["lam_x"], lam_g0=answer["lam_g"]
            )
            if not good and value in _EPS:  # misled by multipliers: once more without them
                told, good = step("cold", value, x0=answer["x"])
        if not good and answer is not None:
            break
        answer = told
        note(np.array(answer["x"]).ravel())
    return np.array(answer["x"]).ravel()


def pympcc(program: Any, note: Note) -> np.ndarray:
    """Its default strategy, with exact sparse Jacobians and Hessian of the Lagrangian from CasADi."""
    import casadi as ca
    import pympcc as peer

    equal = program.rows_lower == program.rows_upper
    inequalities = ca.vertcat(
        *(program.rows[k] - program.rows_upper[k] for k in np.flatnonzero(~equal & np.isfinite(program.rows_upper))),
        *(program.rows_lower[k] - program.rows[k] for k in np.flatnonzero(~equal & np.isfinite(program.rows_lower))),
    )
    equalities = ca.vertcat(*(program.rows[k] - program.rows_lower[k] for k in np.flatnonzero(equal)))
    given: dict[str, Any] = {}
    for name, expression in (("ineq", inequalities), ("eq", equalities), ("comp_G", program.first), ("comp_H", program.second)):
        if expression.shape[0] == 0:
            continue
        body = ca.Function("g", [program.x], [expression])
        jacobian = ca.jacobian(expression, program.x)
        slopes = ca.Function("j", [program.x], [ca.vertcat(*jacobian.nonzeros())]) if jacobian.nnz() else None
        rows, columns = (np.array(index, dtype=int) for index in jacobian.sparsity().get_triplet())
        key = name if name.startswith("comp") else f"{name}_constraints"
        given[key] = lambda x, body=body: np.array(body(x)).ravel()
        given[f"{name}_jacobian"] = lambda x, slopes=slopes: np.zeros(0) if slopes is None else np.array(slopes(x)).ravel()
        given[f"{name}_jacobian_sparsity"] = (rows, columns)
        if not name.startswith("comp"):
            given[f"n_{name}"] = expression.shape[0]
    # Its order of multipliers: inequalities, equalities, both sides, products.
    parts = ca.vertcat(inequalities, equalities, program.first, program.second, program.first * program.second)
    weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", parts.shape[0])
    curved = ca.tril(ca.hessian(weight * program.objective + ca.dot(multipliers, parts), program.x)[0])
    curvature = ca.Function("h", [program.x, multipliers, weight], [ca.vertcat(*curved.nonzeros())])
    given["lagrangian_hessian"] = lambda x, multipliers, weight: np.array(curvature(x, multipliers, weight)).ravel()
    given["lagrangian_hessian_sparsity"] = tuple(np.array(index, dtype=int) for index in curved.sparsity().get_triplet())
    value = ca.Function("f", [program.x], [program.objective])
    slope = ca.Function("df", [program.x], [ca.gradient(program.objective, program.x)])
    problem = peer.MPCCProblem(
        n=program.x.shape[0], n_comp=program.first.shape[0], x0=program.start, xl=program.lower, xu=program.upper,
        objective=lambda x: float(value(x)), gradient=lambda x: np.array(slope(x)).ravel(), **given,
    )  # fmt: skip
    result = peer.solve(problem, strategy="scholtes", callback=lambda k, step: note(np.asarray(step.x, dtype=float)))
    return np.asarray(result.x, dtype=float)
