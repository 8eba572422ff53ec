"""Peers with an interface of their own: mpecss (a dictionary of CasADi functions), nosnoc (a switched system, here one that stands still)."""

# pyright: reportMissingImports=false

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.mpec.solvers import Note

_NO_BOUND = 1e20


def mpecss(program: Any, note: Note) -> np.ndarray:
    """Its own continuation with its defaults; the dictionary is the one that its reader of MacMPEC files makes."""
    import casadi as ca
    from mpecss import run_mpecss

    pairs = program.first.shape[0]
    lower, upper = (np.clip(bound, -_NO_BOUND, _NO_BOUND).tolist() for bound in (program.lower, program.upper))
    rows = [np.clip(bound, -_NO_BOUND, _NO_BOUND).tolist() for bound in (program.rows_lower, program.rows_upper)]
    count = len(rows[0])

    def build(relaxed: Any, shift: Any, smoothing: str = "product") -> dict[str, Any]:
        first, second = program.first, program.second
        product = ca.sqrt(first**2 + second**2) - first - second if smoothing == "fb" else first * second
        return {
            "x": program.x, "f": program.objective, "g": ca.vertcat(program.rows, first + shift, second + shift, product - relaxed),
            "lbg": rows[0] + [0.0] * (2 * pairs) + [-_NO_BOUND] * pairs, "ubg": rows[1] + [_NO_BOUND] * (2 * pairs) + [0.0] * pairs,
            "lbx": lower, "ubx": upper, "n_comp": pairs, "n_orig_con": count, "n_bounded_G": pairs, "n_ubH": 0, "off_G_lb": count,
            "off_H_lb": count + pairs, "off_comp": count + 2 * pairs, "_bounded_G_idx": list(range(pairs)),
        }  # fmt: skip

    problem = {
        "name": "given", "family": "macmpec", "n_x": program.x.shape[0], "n_comp": pairs, "n_con": count, "n_p": 0, "x0_fn": lambda seed=0: program.start,
        "build_casadi": build, "f_fn": ca.Function("f", [program.x], [program.objective]), "G_fn": ca.Function("G", [program.x], [program.first]),
        "H_fn": ca.Function("H", [program.x], [program.second]), "lbx": lower, "ubx": upper, "G_is_free": [False] * pairs, "lbG_eff": [0.0] * pairs,
        "lbH_eff": [0.0] * pairs, "ubH_finite": [], "ubG_finite": [],
    }  # fmt: skip
    return np.asarray(run_mpecss(problem, program.start)["z_final"], dtype=float).ravel()


def nosnoc(program: Any, note: Note) -> np.ndarray:
    """Its homotopy with its defaults. It solves optimal control of switched systems; the program is given as its time-free variables, with
    complementarities between them, beside a system of one state that rests far from its switch, on one step."""
    import casadi as ca
    import nosnoc as peer

    state = ca.SX.sym("state")
    model = peer.NosnocModel(
        x=state, F=[ca.horzcat(0 * state, 0 * state)], S=[np.array([[1], [-1]])], c=[state], x0=np.array([1.0]), v_global=program.x
    )
    options = peer.NosnocOpts()
    options.use_fesd = False
    options.n_s, options.N_stages, options.N_finite_elements = 1, 1, 1
    pairs = program.first.shape[0]
    free = np.full(pairs, np.inf)
    control = peer.NosnocOcp(
        f_terminal=program.objective, g_path=ca.vertcat(program.rows, program.first, program.second),
        lbg=np.concatenate([program.rows_lower, np.zeros(2 * pairs)]), ubg=np.concatenate([program.rows_upper, free, free]),
        g_path_comp=ca.horzcat(program.first, program.second), lbv_global=program.lower, ubv_global=program.upper, v_global_guess=program.start,
    )  # fmt: skip
    return np.asarray(peer.NosnocSolver(options, model, control).solve()["v_global"], dtype=float).ravel()
