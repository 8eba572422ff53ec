"""The peers: each takes a problem and a start and hands back a point. A peer that is not installed or cannot express a problem says so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

# The strict problem itself (eps = 0) as a last step costs more than all others and rarely ends: left out in the peer's favour.
_EPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
_IPOPT = {"print_level": 0, "sb": "yes", "bound_relax_factor": 0.0, "max_iter": 3000, "mu_strategy": "monotone"}


def casadi_scholtes(program: Any) -> np.ndarray:
    """What a good user writes: products <= eps as a parameter, one symbolic build, primal-dual warm starts from step to step. A step that fails
    is not believed: the last good point is the answer."""
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
    warm = {"warm_start_init_point": "yes", "mu_init": 1e-6, **{f"warm_start_{name}": 1e-9 for name in (
        "bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")}}  # fmt: skip
    cold = ca.nlpsol("cold", "ipopt", nlp, {"ipopt": _IPOPT, "print_time": False, "error_on_fail": False})
    again = ca.nlpsol("again", "ipopt", nlp, {"ipopt": {**_IPOPT, **warm}, "print_time": False, "error_on_fail": False})
    answer: Any = None
    for value in _EPS:
        upper = np.concatenate([program.rows_upper, np.full(2 * pairs, np.inf), np.full(pairs, value)])
        if answer is None:
            told = cold(x0=program.start, p=value, ubg=upper, **limits)
            good = cold.stats()["success"]
        else:
            told = again(x0=answer["x"], lam_x0=answer["lam_x"], lam_g0=answer["lam_g"], p=value, ubg=upper, **limits)
            good = again.stats()["success"]
            if not good:  # misled by multipliers: once more without them
                told = cold(x0=answer["x"], p=value, ubg=upper, **limits)
                good = cold.stats()["success"]
        if not good and answer is not None:
            break
        answer = told
    return np.array(answer["x"]).ravel()


def pympcc(program: Any) -> np.ndarray:
    """Its default strategy, with exact sparse derivatives and Hessian from CasADi."""
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
    value = ca.Function("f", [program.x], [program.objective])
    slope = ca.Function("df", [program.x], [ca.gradient(program.objective, program.x)])
    problem = peer.MPCCProblem(
        n=program.x.shape[0], n_comp=program.first.shape[0], x0=program.start, xl=program.lower, xu=program.upper,
        objective=lambda x: float(value(x)), gradient=lambda x: np.array(slope(x)).ravel(), **given,
    )  # fmt: skip
    result = peer.solve(problem, strategy="scholtes", ipopt_options={"print_level": 0})
    return np.asarray(result.x, dtype=float)


def nosnoc_reason() -> str:
    """Why there is no answer: looked at with the package at hand, where it is installed."""
    try:
        import nosnoc
    except ImportError:
        return "not installed: pip install nosnoc"
    return (
        f"{nosnoc.__name__} takes x' = f with switches and transcribes it itself (finite elements with switch detection, implicit Runge-Kutta): neither "
        "the semi-implicit Euler grid of this problem nor a given finite-dimensional MPEC can be handed to it"
    )


def finite(point: np.ndarray) -> np.ndarray:
    if not all(math.isfinite(number) for number in point):
        raise ArithmeticError("the point holds numbers that are not finite")
    return point
