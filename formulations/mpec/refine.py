"""From an interior-point answer to the vertex or face it stands beside: active bounds and rows hold to rounding, multipliers too.

Ipopt stops at about 1e-9 from its bounds, and at 1e-5 from those whose multiplier is zero. Here the active set is guessed, variables with an
active bound are put on it, and Newton's method solves the equations that remain. A guess is taken only where it makes the point better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

from formulations.ipopt import IpoptProblem, IpoptResult

_STEPS = 6
# Up to this many unknowns a dense least-squares solve, which does not mind dependent rows or flat directions.
_DENSE = 150
# Regularisation of the sparse solve: small steps are repeated, so it costs iterations and no accuracy.
_DELTA = 1e-9
# A refined point is the same solution: its objective may differ by this (relative to max(1, |objective|)), and each step by _LONGEST.
_SAME, _LONGEST = 1e-5, 1e-1
_GOOD_ENOUGH = 1e-13


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """x (n,), lagrange (m,) and how far they are from a KKT point: largest of violation, slope and wrong sign."""

    x: np.ndarray
    lagrange: np.ndarray
    error: float


def refined(problem: IpoptProblem, result: IpoptResult) -> Refined:
    """The best of the given point and three guesses of what is active. Bounds are those of the problem as it stands."""
    best = Refined(x=result.x, lagrange=result.lagrange, error=_kkt_error(problem, result.x, result.lagrange))
    limit = _SAME * max(1.0, abs(result.objective))
    for near, by_multiplier in ((1e-5, True), (1e-3, False), (1e-3, True)):
        candidate = _newton(problem, result, near, by_multiplier)
        if candidate is None or not candidate.error < best.error:
            continue
        if abs(problem.sense * problem.objective(candidate.x) - result.objective) <= limit:
            best = candidate
        if best.error <= _GOOD_ENOUGH:
            break
    return best


def violation(problem: IpoptProblem, x: np.ndarray) -> float:
    """Largest violation of a row or bound; inf where a row is not a number.

    Parameters
    ----------
    problem : the compiled problem
    x : (n,) point [units of the variables]
    """
    g = problem.constraints(x)
    sides = [problem.lower - x, x - problem.upper, problem.constraint_lower - g, g - problem.constraint_upper]
    worst = max((float(np.max(side)) for side in sides if side.size), default=0.0)
    return max(worst, 0.0) if np.isfinite(g).all() else float("inf")


def _kkt_error(problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray) -> float:
    """Largest of: violation, slope of a free variable, slope or multiplier with the wrong sign. Slopes relative to the objective's."""
    low, high = problem.lower, problem.upper
    slope = problem.lagrangian_gradient(x, lagrange)
    wrong = np.abs(slope)
    at_low, at_high = x - low <= 1e-12, high - x <= 1e-12
    wrong[at_low] = np.maximum(-slope[at_low], 0.0)
    wrong[at_high] = np.maximum(slope[at_high], 0.0)
    wrong[low == high] = 0.0
    g = problem.constraints(x)
    equal = problem.constraint_lower == problem.constraint_upper
    off_low = ~equal & (lagrange < 0) & (g - problem.constraint_lower > 1e-10)
    off_high = ~equal & (lagrange > 0) & (problem.constraint_upper - g > 1e-10)
    loose = np.abs(lagrange[off_low | off_high])
    scale = max(1.0, float(np.max(np.abs(problem.gradient(x)), initial=0.0)))
    worst = max(float(np.max(wrong, initial=0.0)), float(np.max(loose, initial=0.0))) / scale
    error = max(violation(problem, x), worst)
    return error if np.isfinite(error) else float("inf")


def _newton(problem: IpoptProblem, result: IpoptResult, near: float, by_multiplier: bool) -> Refined | None:
    """Newton on what is active if everything within `near` of its limit is (and, by_multiplier, pulls harder than it is far)."""
    x, y = result.x.copy(), result.lagrange.copy()
    low, high = problem.lower, problem.upper

    def active(gap: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        """Mask (k,) of the limits at distance gap (k,) with multiplier (k,) that are active [-]."""
        return (gap <= near) & ((multiplier > gap) | (gap <= 1e-12)) if by_multiplier else gap <= near

    at_low = active(x - low, result.zl) | (low == high)
    at_high = active(high - x, result.zu) & ~at_low
    x[at_low], x[at_high] = low[at_low], high[at_high]
    free = np.flatnonzero(~(at_low | at_high))
    g = problem.constraints(x)
    equal = problem.constraint_lower == problem.constraint_upper
    is_low = equal | active(np.abs(g - problem.constraint_lower), -y)
    is_high = ~is_low & active(np.abs(problem.constraint_upper - g), y)
    rows = np.flatnonzero(is_low | is_high)
    target = np.where(is_low, problem.constraint_lower, problem.constraint_upper)[rows]
    y[~(is_low | is_high)] = 0.0
    for _ in range(_STEPS):
        step = _step(problem, x, y, free, rows, target)
        if (
            step is None
            or not np.all(np.isfinite(step))
            or np.max(np.abs(step[: len(free)]), initial=0.0) > _LONGEST * (1 + np.max(np.abs(x), initial=0.0))
        ):
            return None
        x[free] += step[: len(free)]
        y[rows] = step[len(free) :]
        if np.max(np.abs(step[: len(free)]), initial=0.0) < 1e-15 * (1 + np.max(np.abs(x), initial=0.0)):
            break
    return Refined(x=x, lagrange=y, error=_kkt_error(problem, x, y))


def _step(problem: IpoptProblem, x: np.ndarray, y: np.ndarray, free: np.ndarray, rows: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """(step of the free variables, new multipliers of the active rows)."""
    row, column = problem.jacobianstructure()
    jacobian = sparse.csr_matrix((problem.jacobian(x), (row, column)), shape=(problem.m, problem.n))[rows][:, free]
    row, column = problem.hessianstructure()
    lower = sparse.csr_matrix((problem.hessian(x, y, 1.0), (row, column)), shape=(problem.n, problem.n))
    hessian = (lower + sparse.tril(lower, -1).T).tocsr()[free][:, free]
    right = np.concatenate([-problem.gradient(x)[free], target - problem.constraints(x)[rows]])
    if not np.all(np.isfinite(right)):
        return None
    system = sparse.bmat([[hessian, jacobian.T], [jacobian, sparse.csr_matrix((len(rows), len(rows)))]], format="csc")
    if system.shape[0] <= _DENSE:
        return np.linalg.lstsq(system.toarray(), right, rcond=1e-12)[0] if system.shape[0] else np.zeros(0)
    signs = np.concatenate([np.full(len(free), _DELTA), np.full(len(rows), -_DELTA)])
    right[len(free) :] -= _DELTA * y[rows]  # a proximal step: the regularisation vanishes as the multipliers settle
    try:
        return splu((system + sparse.diags(signs)).tocsc()).solve(right)
    except RuntimeError:  # singular in spite of the regularisation
        return None
