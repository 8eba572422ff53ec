"""Multipliers of a point by least squares: one sparse factorisation instead of linear programs, wherever the active gradients are independent.

    minimise |gradient - A y|^2   ->   [I  A; A' 0] (r, y) = (gradient, 0)

If that matrix is regular, y is the only candidate: what its residual and signs say is the whole truth (class S and B-stationarity are then the same), and no linear program is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator, onenormest, splu

_REFINEMENTS = 3  # of the solution of the augmented system; the first brings three plans of 500 to 5000 steps from 1e-9 to 1e-14
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
