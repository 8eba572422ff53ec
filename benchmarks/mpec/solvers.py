"""Peers: each takes a program, tells `note` every point it believes on its way, and hands back the last.

Two have an interface of their own, and tell nothing on their way: mpecss (a dictionary of CasADi
functions) and nosnoc (a switched system, here one that stands still).
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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
# What mpecss takes for infinite.
_NO_BOUND = 1e20
_TIGHT = {"tol": 1e-11, "constr_viol_tol": 1e-11, "compl_inf_tol": 1e-11, "mu_init": 1e-11}
Note = Callable[[np.ndarray], None]


def casadi_scholtes(program: Any, note: Note) -> np.ndarray:
    """What a good user writes: products <= eps as a parameter, exact sparse Hessian, primal-dual warm starts from step to step, tighter
    tolerances for the last steps. A step that fails is not believed: the last good point is the
    answer.
    """
    import casadi as ca

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
        note(np.array(answer["x"]).ravel())
    return np.array(answer["x"]).ravel()


def pympcc(program: Any, note: Note) -> np.ndarray:
    """Its default strategy, with exact sparse Jacobians and Hessian of the Lagrangian from CasADi."""
    import casadi as ca
    import pympcc as peer

    equal = program.rows_lower == program.rows_upper
    inequalities = ca.vertcat(
        *(
            program.rows[k] - program.rows_upper[k]
            for k in np.flatnonzero(~equal & np.isfinite(program.rows_upper))
        ),
        *(
            program.rows_lower[k] - program.rows[k]
            for k in np.flatnonzero(~equal & np.isfinite(program.rows_lower))
        ),
    )
    equalities = ca.vertcat(
        *(program.rows[k] - program.rows_lower[k] for k in np.flatnonzero(equal))
    )
    given: dict[str, Any] = {}
    for name, expression in (
        ("ineq", inequalities),
        ("eq", equalities),
        ("comp_G", program.first),
        ("comp_H", program.second),
    ):
        if expression.shape[0] == 0:
            continue
        body = ca.Function("g", [program.x], [expression])
        jacobian = ca.jacobian(expression, program.x)
        slopes = (
            ca.Function("j", [program.x], [ca.vertcat(*jacobian.nonzeros())])
            if jacobian.nnz()
            else None
        )
        rows, columns = (np.array(index, dtype=int) for index in jacobian.sparsity().get_triplet())
        key = name if name.startswith("comp") else f"{name}_constraints"
        given[key] = lambda x, body=body: np.array(body(x)).ravel()
        given[f"{name}_jacobian"] = lambda x, slopes=slopes: (
            np.zeros(0) if slopes is None else np.array(slopes(x)).ravel()
        )
        given[f"{name}_jacobian_sparsity"] = (rows, columns)
        if not name.startswith("comp"):
            given[f"n_{name}"] = expression.shape[0]
    # Its order of multipliers: inequalities, equalities, both sides, products.
    parts = ca.vertcat(
        inequalities, equalities, program.first, program.second, program.first * program.second
    )
    weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", parts.shape[0])
    curved = ca.tril(
        ca.hessian(weight * program.objective + ca.dot(multipliers, parts), program.x)[0]
    )
    curvature = ca.Function("h", [program.x, multipliers, weight], [ca.vertcat(*curved.nonzeros())])
    given["lagrangian_hessian"] = lambda x, multipliers, weight: np.array(
        curvature(x, multipliers, weight)
    ).ravel()
    given["lagrangian_hessian_sparsity"] = tuple(
        np.array(index, dtype=int) for index in curved.sparsity().get_triplet()
    )
    value = ca.Function("f", [program.x], [program.objective])
    slope = ca.Function("df", [program.x], [ca.gradient(program.objective, program.x)])
    problem = peer.MPCCProblem(
        n=program.x.shape[0], n_comp=program.first.shape[0], x0=program.start, xl=program.lower,
        xu=program.upper,
        objective=lambda x: float(value(x)), gradient=lambda x: np.array(slope(x)).ravel(), **given,
    )  # fmt: skip
    result = peer.solve(
        problem, strategy="scholtes", callback=lambda k, step: note(np.asarray(step.x, dtype=float))
    )
    return np.asarray(result.x, dtype=float)


def mpecss(program: Any, note: Note) -> np.ndarray:
    """Its own continuation with its defaults.

    The dictionary is the one that its reader of MacMPEC files makes.
    """
    import casadi as ca
    from mpecss import run_mpecss

    pairs = program.first.shape[0]
    lower, upper = (
        np.clip(bound, -_NO_BOUND, _NO_BOUND).tolist() for bound in (program.lower, program.upper)
    )
    rows = [
        np.clip(bound, -_NO_BOUND, _NO_BOUND).tolist()
        for bound in (program.rows_lower, program.rows_upper)
    ]
    count = len(rows[0])

    def build(relaxed: Any, shift: Any, smoothing: str = "product") -> dict[str, Any]:
        first, second = program.first, program.second
        product = (
            ca.sqrt(first**2 + second**2) - first - second if smoothing == "fb" else first * second
        )
        return {
            "x": program.x, "f": program.objective,
            "g": ca.vertcat(program.rows, first + shift, second + shift, product - relaxed),
            "lbg": rows[0] + [0.0] * (2 * pairs) + [-_NO_BOUND] * pairs,
            "ubg": rows[1] + [_NO_BOUND] * (2 * pairs) + [0.0] * pairs,
            "lbx": lower, "ubx": upper, "n_comp": pairs, "n_orig_con": count, "n_bounded_G": pairs,
            "n_ubH": 0, "off_G_lb": count,
            "off_H_lb": count + pairs, "off_comp": count + 2 * pairs,
            "_bounded_G_idx": list(range(pairs)),
        }  # fmt: skip

    problem = {
        "name": "given", "family": "macmpec", "n_x": program.x.shape[0], "n_comp": pairs,
        "n_con": count, "n_p": 0, "x0_fn": lambda seed=0: program.start,
        "build_casadi": build, "f_fn": ca.Function("f", [program.x], [program.objective]),
        "G_fn": ca.Function("G", [program.x], [program.first]),
        "H_fn": ca.Function("H", [program.x], [program.second]), "lbx": lower, "ubx": upper,
        "G_is_free": [False] * pairs, "lbG_eff": [0.0] * pairs,
        "lbH_eff": [0.0] * pairs, "ubH_finite": [], "ubG_finite": [],
    }  # fmt: skip
    return np.asarray(run_mpecss(problem, program.start)["z_final"], dtype=float).ravel()


def nosnoc(program: Any, note: Note) -> np.ndarray:
    """Its homotopy with its defaults.

    It solves optimal control of switched systems; the program is given as its time-free variables,
    with

    complementarities between them, beside a system of one state that rests far from its switch, on
    one step.
    """
    import casadi as ca
    import nosnoc as peer

    state = ca.SX.sym("state")
    model = peer.NosnocModel(
        x=state,
        F=[ca.horzcat(0 * state, 0 * state)],
        S=[np.array([[1], [-1]])],
        c=[state],
        x0=np.array([1.0]),
        v_global=program.x,
    )
    options = peer.NosnocOpts()
    options.use_fesd = False
    options.n_s, options.N_stages, options.N_finite_elements = 1, 1, 1
    pairs = program.first.shape[0]
    free = np.full(pairs, np.inf)
    control = peer.NosnocOcp(
        f_terminal=program.objective,
        g_path=ca.vertcat(program.rows, program.first, program.second),
        lbg=np.concatenate([program.rows_lower, np.zeros(2 * pairs)]),
        ubg=np.concatenate([program.rows_upper, free, free]),
        g_path_comp=ca.horzcat(program.first, program.second), lbv_global=program.lower,
        ubv_global=program.upper, v_global_guess=program.start,
    )  # fmt: skip
    return np.asarray(
        peer.NosnocSolver(options, model, control).solve()["v_global"], dtype=float
    ).ravel()
