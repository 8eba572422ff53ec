"""The same quadratic program by Clarabel: an interior-point method does not mind how many conditions are active.

Its answer is only used to name the active conditions, those whose multiplier exceeds their slack; the equality problem then solves exactly.
On the questions that came here it took 0.1 to 0.7 of the CPU of an interior-point method of our own on the banded matrix, and found all that it found.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse as sp

from formulations.windows.linear_scene import LinearScene

# Of the gap and of the conditions: Clarabel's own 1e-8 takes as long, and tells slack from multiplier less clearly.
_TOLERANCE = 1e-10


def active_set(linear: LinearScene, closed: np.ndarray, ball: float, softness: float = 0.0) -> tuple[np.ndarray, np.ndarray] | None:
    """(side (steps, nu), touching (steps, nc)) at the optimum, or None where none was found: see `quadratic` for the problem.

    The unknowns are z[0..T], u, and by how much z[T] leaves the goal: what a softness lets it, then what the ball does.
    """
    T, n, nu, nc = linear.steps, linear.n, linear.nu, linear.nc
    aimed = np.flatnonzero(linear.aimed)
    m = len(aimed)
    soft, near = m * (softness > 0.0), m * (ball > 0.0)
    each, now, later, inputs = sp.eye(T), sp.eye(T, T + 1), sp.eye(T, T + 1, k=1), sp.eye(T * nu, format="csr")

    states = sp.bmat([[sp.kron(now.T @ now, linear.H[:n, :n]), sp.kron(now.T, linear.H[:n, n:])], [None, sp.kron(each, linear.H[n:, n:])]])
    price = np.concatenate([np.full(soft, 1.0 / softness if soft else 0.0), np.zeros(near)])
    slope = np.concatenate([np.tile(linear.g[:n], T), np.zeros(n), np.tile(linear.g[n:], T), np.zeros(soft + near)])

    phi, pushed = sp.kron(now, linear.P, format="csr"), closed * linear.k
    forward = sp.kron(later, np.eye(n)) - sp.kron(now, linear.A) - sp.kron(each, linear.E) @ sp.diags(pushed.ravel()) @ phi
    sign = np.where(closed[1:], 1.0, -1.0)  # the start decides phi there
    low, up = (np.tile(np.isfinite(bound), T) for bound in (linear.lower, linear.upper))
    blocks = [
        [sp.eye(n, (T + 1) * n), None, None, None],
        [forward, -sp.kron(each, linear.B), None, None],
        [sp.eye((T + 1) * n, format="csr")[T * n + aimed], None, -sp.eye(m, soft), -sp.eye(m, near)],
        [-sp.diags(sign.ravel()) @ phi[nc:], None, None, None],
        [None, -inputs[low], None, None],
        [None, inputs[up], None, None],
        [None, None, None, -sp.eye(near + 1, near, k=-1)],
    ]
    values = [
        linear.start,
        (linear.c + (pushed * linear.p) @ linear.E.T).ravel(),
        linear.goal[aimed],
        (sign * linear.p).ravel(),
        -np.tile(linear.lower, T)[low],
        np.tile(linear.upper, T)[up],
        np.array([ball, *np.zeros(near)]),
    ]
    fixed, free = (sum(len(part) for part in parts) for parts in (values[:3], values[3:6]))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.direct_solve_method = False, "qdldl"  # one thread, the same bits in every run
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    found = clarabel.DefaultSolver(
        sp.triu(sp.block_diag([states, sp.diags(price)]), format="csc"),
        slope,
        sp.bmat(blocks, format="csc"),
        np.concatenate(values),
        [clarabel.ZeroConeT(fixed), clarabel.NonnegativeConeT(free), clarabel.SecondOrderConeT(near + 1)],
        settings,
    ).solve()
    if str(found.status) not in ("Solved", "AlmostSolved"):
        return None
    active = (np.array(found.z) > np.array(found.s))[fixed : fixed + free]
    touching, on_lower, on_upper = np.split(active, np.cumsum([sign.size, int(low.sum())]))
    side = np.zeros(T * nu, dtype=int)
    side[low] -= on_lower
    side[up] += on_upper
    return side.reshape(T, nu), np.vstack([np.zeros((1, nc), dtype=bool), touching.reshape(T - 1, nc)])
