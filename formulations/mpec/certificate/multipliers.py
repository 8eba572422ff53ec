"""Multipliers of a point by least squares: a sparse factorisation instead of linear programs.

    minimise |gradient - A y|^2   ->   [I  A; A' 0] (r, y) = (gradient, 0)

If that matrix is regular, y is the only candidate: what its residual and signs say is the whole truth (class S and B-stationarity are then the same), and no linear program is needed.
If it is singular there are many y, and the same with -eps I in its corner, repeated (proximal point method; Rockafellar, SIAM J. Control and
Optimization 14, 1976), finds one that leaves as little. Where its signs are right, that is enough; where they are wrong, others may still be right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator, onenormest, splu

_REFINEMENTS = 3  # of the solution of the augmented system; the first brings three plans of 500 to 5000 steps from 1e-9 to 1e-14
# Of the proximal point method with columns of length 1: eps, most steps of one solution, and how often multipliers of the wrong sign are left out
# and the rest is found again. A step that leaves more than _STALLS of what the last one
# left, and of its products with the columns, is the last.
_PROXIMAL, _STEPS, _ROUNDS, _STALLS = 1e-12, 12, 6, 0.9
_REGULAR = 1e14  # largest condition number (1-norm, estimated) of the augmented system that still counts as regular


@dataclass(frozen=True, kw_only=True, eq=False)
class LeastSquares:
    """y (columns,): the multipliers; rest (n,): what they leave of the gradient."""

    y: np.ndarray
    rest: np.ndarray
    _solve: Callable[[np.ndarray], np.ndarray]

    def leaving(self, column: int) -> np.ndarray:
        """(n,) the shortest direction in which the condition of this column rises by one and all others stay: the objective changes by y[column]."""
        right = np.zeros(len(self.rest) + len(self.y))
        right[len(self.rest) + column] = 1.0
        return self._solve(right)[: len(self.rest)]


def least_squares(matrix: sparse.csc_matrix, gradient: np.ndarray) -> LeastSquares | None:
    """matrix (n, columns): active gradients. None where they are not linearly independent (then there may be many y, or it is not known)."""
    n, columns = matrix.shape
    if columns > n:
        return None
    if not columns:
        return LeastSquares(y=np.zeros(0), rest=gradient, _solve=lambda right: right)
    system = sparse.bmat([[sparse.identity(n), matrix], [matrix.T, None]], format="csc")
    try:
        factors = splu(system)
    except RuntimeError:  # exactly singular
        return None
    size = n + columns
    inverse = LinearOperator((size, size), matvec=factors.solve, rmatvec=lambda x: factors.solve(x, trans="T"), dtype=float)
    if not onenormest(inverse) * abs(system).sum(axis=0).max() <= _REGULAR:  # NaN counts as singular
        return None
    right = np.concatenate([gradient, np.zeros(columns)])
    solution = factors.solve(right)
    for _ in range(_REFINEMENTS):
        solution = solution + factors.solve(right - system @ solution)
    y = solution[n:]
    return LeastSquares(y=y, rest=gradient - matrix @ y, _solve=factors.solve)


@dataclass(frozen=True, kw_only=True, eq=False)
class SignedMultipliers:
    """y (columns,) within its limits, and what it leaves (n,); least (n,): what the best without limits leave; across: the largest product of a
    column with `least`, 0 but for rounding."""

    y: np.ndarray
    rest: np.ndarray
    least: np.ndarray
    across: float


def signed_least_squares(
    matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float
) -> SignedMultipliers | None:
    """Multipliers within limits (which hold 0) that leave at most the tolerance in each component, if that is found; else those found last.

    The columns may depend on each other. None where there is no column, or the factorisation fails.
    """
    columns = matrix.shape[1]
    y = proximal_least_squares(matrix, gradient)
    if y is None:
        return None
    least = gradient - matrix @ y
    held = np.clip(y, low, high)
    for _ in range(_ROUNDS):
        wrong = held != y
        if np.max(np.abs(gradient - matrix @ held), initial=0.0) <= tolerance or not np.any(wrong):
            break
        chosen = np.flatnonzero((held != 0.0) & ~wrong)
        part = proximal_least_squares(matrix[:, chosen], gradient)
        if part is None:
            break
        y = np.zeros(columns)
        y[chosen] = part
        held = np.clip(y, low, high)
    across = float(np.max(np.abs(matrix.T @ least), initial=0.0))
    return SignedMultipliers(y=held, rest=gradient - matrix @ held, least=least, across=across)


def proximal_least_squares(matrix: sparse.csc_matrix, gradient: np.ndarray) -> np.ndarray | None:
    """(columns,) least squares by the proximal point method; None if the factorisation fails."""
    n, columns = matrix.shape
    if not columns:
        return None
    length = column_lengths(matrix)
    matrix = (matrix @ sparse.diags(1.0 / length)).tocsc()
    try:
        factors = splu(sparse.bmat([[sparse.identity(n), matrix], [matrix.T, -_PROXIMAL * sparse.identity(columns)]], format="csc"))
    except RuntimeError:
        return None
    y, rest = np.zeros(columns), gradient
    for _ in range(_STEPS):
        trial = y + factors.solve(np.concatenate([rest, np.zeros(columns)]))[n:]
        left = gradient - matrix @ trial
        shorter = np.linalg.norm(left) < _STALLS * np.linalg.norm(rest)
        straighter = np.linalg.norm(matrix.T @ left) < _STALLS * np.linalg.norm(matrix.T @ rest)
        if not (shorter or straighter):  # as good as it gets; NaN too
            break
        y, rest = trial, left
    return y / length


def column_lengths(matrix: sparse.csc_matrix) -> np.ndarray:
    """(columns,) 2-norms; 1 for a column of zeros."""
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=0)).ravel())
    return np.where(length == 0.0, 1.0, length)
