"""Banded LU with row pivoting in compiled C: milliseconds for a plan of some hundred steps, always one thread.

    band = BandedLU(size, width)
    band.factor(matrix)                 # (2*width + 1, size), Fortran order: entry (i, j) at [width + i - j, j]; False where singular
    x = band.solve(right)               # right (size,) or (size, m)

LAPACK's gbtrf and gbtrs do the same through SciPy. Measured on three_cart x mpcc_front they took 1.7 times the CPU of the whole solve: their loop over
the columns calls the BLAS twice for each, for ten numbers; and where the threads of the BLAS are not limited, these spin, three times.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler

_SOURCE = Path(__file__).with_name("band.c")
_INT, _POINTER = ctypes.c_int, ctypes.c_void_p
_SIGNATURES = {
    "band_factor": (_INT, (_INT, _INT, _POINTER, _POINTER)),
    "band_solve": (None, (_INT, _INT, _POINTER, _POINTER, _POINTER)),
    "band_product": (None, (_INT, _INT, _POINTER, _POINTER, _POINTER)),
}


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """Compiled once and cached on disk. Raises MachineError without a compiler."""
    compiler, text = find_compiler(), _SOURCE.read_text(encoding="utf-8")
    key = "\n".join([compiler.describe(), " ".join((*FLAGS, "-O3")), text])
    library = ctypes.CDLL(str(cached(key, ".so", lambda path: compile_shared(compiler, {"band.c": text}, path, extra_flags=("-O3",)))))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, list(arguments)
    return library


class BandedLU:
    """See the module docstring."""

    def __init__(self, size: int, width: int) -> None:
        self._size, self._width = size, width
        self._library = _library()
        self._matrix = np.zeros((2 * width + 1, size), order="F")
        self._factors, self._pivots = np.zeros((3 * width + 1, size), order="F"), np.zeros(size, dtype=np.intc)

    def factor(self, matrix: np.ndarray) -> bool:
        """Factorise; False where a pivot is exactly zero. The matrix is kept, and must not be written to afterwards."""
        self._matrix = np.asfortranarray(matrix, dtype=np.float64)
        self._factors[: self._width], self._factors[self._width :] = 0.0, matrix
        return self._library.band_factor(self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data) == 0

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for right (size,) or (size, m), refined once by its own residual."""
        found = self._back(right)
        return found + self._back(right - self.product(found))

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the last factorisation times x (size,) or (size, m)."""
        columns = np.array(x.T, dtype=np.float64, order="C", ndmin=2)
        found = np.empty_like(columns)
        for column, row in zip(columns, found, strict=True):
            self._library.band_product(self._size, self._width, self._matrix.ctypes.data, column.ctypes.data, row.ctypes.data)
        return found.T.reshape(x.shape)

    def _back(self, right: np.ndarray) -> np.ndarray:
        columns = np.array(right.T, dtype=np.float64, order="C", ndmin=2)
        for column in columns:
            self._library.band_solve(self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data, column.ctypes.data)
        return columns.T.reshape(right.shape)
