"""Banded LU with row pivoting: LAPACK's gbtrf and gbtrs, each solution refined once by its own residual.

band = BandedLU(size, width)
band.factor(matrix)                 # (2*width + 1, size): entry (i, j) at [width + i - j, j]; False where singular
x = band.solve(right)               # right (size,) or (size, m)
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgbmv
from scipy.linalg.lapack import dgbtrf, dgbtrs


class BandedLU:
    """See the module docstring."""

    def __init__(self, size: int, width: int) -> None:
        self._width = width
        self._room = np.zeros((3 * width + 1, size), order="F")  # with what pivoting fills
        self._matrix, self._pivots = np.empty((2 * width + 1, size)), np.empty(size, dtype=np.intc)
        self._factors = self._room

    def factor(self, matrix: np.ndarray) -> bool:
        """Factorise; False where a pivot is exactly zero. The matrix is kept, and must not be written to afterwards."""
        self._matrix = matrix
        self._room[: self._width], self._room[self._width :] = 0.0, matrix
        self._factors, self._pivots, info = dgbtrf(self._room, self._width, self._width, overwrite_ab=True)
        return info == 0

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for right (size,) or (size, m)."""
        found = self._back(right)
        return found + self._back(right - self.product(found))

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the last factorisation times x (size,) or (size, m)."""
        if x.ndim > 1:
            return np.stack([self.product(column) for column in x.T], axis=1)
        size, width = len(x), self._width
        rows = max(size, 2 * width + 1)  # fewer SciPy refuses; those beyond the matrix are cut off
        return dgbmv(rows, size, width, width, 1.0, self._matrix, x)[:size]

    def _back(self, right: np.ndarray) -> np.ndarray:
        found, _ = dgbtrs(self._factors, self._width, self._width, right, self._pivots)
        return found
