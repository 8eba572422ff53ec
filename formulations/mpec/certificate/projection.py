"""The gradient of the objective projected onto the cone that the active gradients span with the signs their multipliers may have.

    minimise |gradient - A y|^2   over the y with the right signs:   gradient = A y + rest

Either the rest vanishes, and y are multipliers; or -rest leaves every active condition where it is or on its good side, and the objective falls
along it (Moreau's decomposition, the lemma of Farkas). Found by a primal-dual interior point method with predictor and corrector (Mehrotra, SIAM
J. Optimization 2, 1992) on the sparse system [I A; A' -D]: some twenty factorisations, which are cheap where time couples neighbours only.
Nothing rests on its having converged: whoever asks judges y and rest themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

from formulations.mpec.certificate.multipliers import column_lengths, proximal_least_squares

# Of a step in y with columns of length 1: keeps the system regular where gradients depend on each other, and is gone where steps end.
_DAMPING = 1e-10
_ITERATIONS, _TO_THE_BOUNDARY = 60, 0.995
# The first y and z are at least this share of the gradient's length away from 0.
_INSIDE = 1e-2
# Solved where the sum of y z is this share of |rest|^2 and the conditions hold to this share of |rest|; or this share of the gradient is left.
_GAP, _DUAL, _NOTHING_LEFT = 1e-12, 1e-10, 1e-10
# Where the sum of y z is that small, but gradients depend on each other so nearly that the damping holds y back (for 60 steps and more), least squares
# with the columns that count may be the answer already: to this share of the lengths that are subtracted.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class Projection:
    """y (columns,) with the right signs, and rest (n,) = gradient - A y: of what was found, that whose largest component is smallest. polar (n,):
    of what was found, the rest that is nearest to leaving every condition on its good side; across: by how much it puts one on its bad side, at most."""

    y: np.ndarray
    rest: np.ndarray
    polar: np.ndarray
    across: float


def project(matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> Projection | None:
    """low, high (columns,): limits of y, each 0 or infinite. None where a factorisation fails."""
    chosen = np.flatnonzero((low < 0.0) | (high > 0.0))
    free, falling = (low[chosen] < 0.0) & (high[chosen] > 0.0), high[chosen] <= 0.0
    part = (matrix[:, chosen] @ sparse.diags(np.where(falling, -1.0, 1.0))).tocsc()
    length = column_lengths(part)
    columns = len(chosen)
    candidates: list[np.ndarray] = [] if columns else [np.zeros(0)]
    used = np.ones(columns, dtype=bool)
    if not np.all(free):
        found = _interior_point((part @ sparse.diags(1.0 / length)).tocsc(), gradient, np.flatnonzero(~free))
        if found is None:
            return None
        candidates, used = [found[0] / length], found[1]
    exact = proximal_least_squares(part[:, used], gradient)
    if exact is not None:
        candidates.append(np.zeros(columns))
        candidates[-1][used] = exact
    if not candidates:
        return None
    signed = [np.where(free, y, np.maximum(y, 0.0)) for y in candidates]
    rests, polars = ([gradient - part @ y for y in ys] for ys in (signed, candidates))
    across = [float(np.max(np.where(free, np.abs(products), products), initial=0.0)) for products in (part.T @ p for p in polars)]
    best = int(np.argmin([np.max(np.abs(rest), initial=0.0) for rest in rests]))
    straight = int(np.argmin(across))
    y = np.zeros(matrix.shape[1])
    y[chosen] = np.where(falling, -1.0, 1.0) * signed[best]
    return Projection(y=y, rest=rests[best], polar=polars[straight], across=across[straight])


def _interior_point(matrix: sparse.csc_matrix, gradient: np.ndarray, signed: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(y, which columns count: all but those whose y vanishes); columns of length 1, y[signed] >= 0. None where a factorisation fails."""
    columns = matrix.shape[1]
    size, count = float(np.linalg.norm(gradient)), len(signed)
    if size == 0.0:
        return np.zeros(columns), np.zeros(columns, dtype=bool)
    diagonal = np.full(columns, _DAMPING)
    diagonal[signed] = 1.0
    solve = _factorised(matrix, diagonal)
    if solve is None:
        return None
    y = solve(gradient, np.zeros(columns))
    z = np.maximum(np.abs(matrix[:, signed].T @ (gradient - matrix @ y)), _INSIDE * size)
    y[signed] = np.maximum(np.abs(y[signed]), _INSIDE * size)
    looked_at = np.zeros(0, dtype=bool)
    for _ in range(_ITERATIONS):
        rest = gradient - matrix @ y
        off = matrix.T @ rest
        off[signed] += z
        left, gap = float(np.linalg.norm(rest)), float(y[signed] @ z)
        if left <= _NOTHING_LEFT * size or (gap <= _GAP * left**2 and np.max(np.abs(off)) <= _DUAL * left):
            break
        counts = y[signed] > z
        if gap <= _GAP * left**2 and not np.array_equal(counts, looked_at):
            looked_at = counts
            exact = _settled(matrix, gradient, signed, counts)
            if exact is not None:
                return exact
        diagonal[signed] = z / y[signed] + _DAMPING
        solve = _factorised(matrix, diagonal)
        if solve is None:
            break
        target = np.zeros(count)  # of y z: 0 for the predictor
        for is_corrector in (False, True):
            right = np.zeros(columns)
            right[signed] = -target / y[signed]
            step = solve(rest, right)
            change = step[signed]
            z_change = (target - z * change) / y[signed] - z
            reach = min(_reach(y[signed], change), _reach(z, z_change))
            if not is_corrector:
                ahead = float((y[signed] + min(1.0, reach) * change) @ (z + min(1.0, reach) * z_change))
                target = gap / count * (ahead / gap) ** 3 - change * z_change
        if not np.all(np.isfinite(step)):
            break
        along = min(1.0, _TO_THE_BOUNDARY * reach)
        y, z = y + along * step, z + along * z_change
    used = np.ones(columns, dtype=bool)
    used[signed] = y[signed] > z
    return y, used


def _settled(
    matrix: sparse.csc_matrix, gradient: np.ndarray, signed: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Least squares with the signed columns that count and all others, and which these are; None where that is not the projection."""
    used = np.ones(matrix.shape[1], dtype=bool)
    used[signed] = counts
    part = proximal_least_squares(matrix[:, used], gradient)
    if part is None:
        return None
    y = np.zeros(len(used))
    y[used] = part
    rest = gradient - matrix @ y
    products = matrix.T @ rest
    products[used] = np.abs(products[used])  # of the others only those that would shorten the rest count
    lengths = float(np.linalg.norm(gradient)) + float(np.max(np.abs(y), initial=0.0))
    enough = max(_DUAL * float(np.linalg.norm(rest)), _ROUNDING * lengths)
    return (y, used) if np.all(y[signed] >= 0.0) and np.max(products, initial=0.0) <= enough else None


def _factorised(matrix: sparse.csc_matrix, diagonal: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray] | None:
    """Solves s + A dy = first, A' s - diagonal dy = second for dy. None where the factorisation fails."""
    n = matrix.shape[0]
    try:
        factors = splu(sparse.bmat([[sparse.identity(n), matrix], [matrix.T, -sparse.diags(diagonal)]], format="csc"))
    except RuntimeError:
        return None
    return lambda first, second: factors.solve(np.concatenate([first, second]))[n:]


def _reach(values: np.ndarray, change: np.ndarray) -> float:
    """How far to go along a change until one of the values, which are positive, is 0."""
    falls = change < 0.0
    return float(np.min(-values[falls] / change[falls], initial=np.inf))
