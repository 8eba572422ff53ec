"""From an interior-point answer to the vertex or face it stands beside: bounds that are active hold exactly, active rows to rounding.

Ipopt stops at about 1e-9 from its bounds. Here variables with an active bound are put on it, and the rest moves by the smallest step that
makes all active rows hold (Newton, least norm). Taken only where it makes the point better.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

from formulations.ipopt import IpoptProblem, IpoptResult

# A bound this near with a multiplier larger than the distance is active (strict complementarity of the interior point).
_NEAR = 1e-5
_STEPS = 4
# Up to this many entries a dense least-squares solve, which does not mind dependent rows.
_DENSE = 250_000


def refined(problem: IpoptProblem, result: IpoptResult) -> np.ndarray:
    """A better x (n,), or result.x itself. Bounds are those of the problem as it stands."""
    x = result.x.copy()
    low, high = problem.lower, problem.upper
    at_low = (x - low <= _NEAR) & ((x - low < result.zl) | (x - low <= 1e-12) | (low == high))
    at_high = (high - x <= _NEAR) & ((high - x < result.zu) | (high - x <= 1e-12)) & ~at_low
    x[at_low], x[at_high] = low[at_low], high[at_high]
    x = np.clip(x, low, high)
    free = np.flatnonzero(~(at_low | at_high))
    g = problem.constraints(x)
    y = result.lagrange
    is_low = (np.abs(g - problem.constraint_lower) <= _NEAR) & (-y > g - problem.constraint_lower)
    is_high = (np.abs(problem.constraint_upper - g) <= _NEAR) & (y > problem.constraint_upper - g)
    equal = problem.constraint_lower == problem.constraint_upper
    active = np.flatnonzero(equal | is_low | is_high)
    target = np.where(equal | is_low, problem.constraint_lower, problem.constraint_upper)[active]
    best, worst = result.x, violation(problem, result.x)
    if not active.size or not free.size:
        return x if violation(problem, x) <= worst else best
    for _ in range(_STEPS):
        now = violation(problem, x)
        if now < worst or (best is result.x and now <= worst):
            best, worst = x.copy(), now
        step = _least_step(problem, x, active, free, target - problem.constraints(x)[active])
        if step is None or not np.all(np.isfinite(step)) or np.max(np.abs(step), initial=0.0) > 1e3 * _NEAR:
            break
        x[free] += step
        x = np.clip(x, low, high)
        if np.max(np.abs(step), initial=0.0) < 1e-16:
            break
    return x if violation(problem, x) < worst else best


def violation(problem: IpoptProblem, x: np.ndarray) -> float:
    """Largest violation of a row or bound; inf where a row is not a number."""
    g = problem.constraints(x)
    sides = [problem.lower - x, x - problem.upper, problem.constraint_lower - g, g - problem.constraint_upper]
    worst = max((float(np.max(side)) for side in sides if side.size), default=0.0)
    return max(worst, 0.0) if np.isfinite(g).all() else float("inf")


def _least_step(problem: IpoptProblem, x: np.ndarray, active: np.ndarray, free: np.ndarray, missing: np.ndarray) -> np.ndarray | None:
    rows, columns = problem.jacobianstructure()
    matrix = sparse.csr_matrix((problem.jacobian(x), (rows, columns)), shape=(problem.m, problem.n))[active][:, free]
    if matrix.shape[0] * matrix.shape[1] <= _DENSE:
        return np.linalg.lstsq(matrix.toarray(), missing, rcond=1e-10)[0]
    count = matrix.shape[0]
    system = sparse.bmat([[sparse.identity(len(free)), matrix.T], [matrix, -1e-12 * sparse.identity(count)]], format="csc")
    try:
        return splu(system).solve(np.concatenate([np.zeros(len(free)), missing]))[: len(free)]
    except RuntimeError:  # exactly singular
        return None
