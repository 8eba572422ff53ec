"""Banded LU with row pivoting in compiled C: milliseconds for a plan of some hundred steps, always one thread.

    band = BandedLU(size, width)
    band.factor(matrix)                 # (2*width + 1, size), Fortran order: entry (i, j) at [width + i - j, j]; False where singular
    x = band.solve(right)               # right (size,) or (size, m)

LAPACK's gbtrf does the same through SciPy, whose import costs more CPU than a whole plan, and whose BLAS keeps a second thread spinning.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler

_SOURCE = Path(__file__).with_name("band.c")
_POINTER = ctypes.c_void_p
_SIGNATURES = {
    "band_factor": (ctypes.c_int, (ctypes.c_int, ctypes.c_int, _POINTER, _POINTER)),
    "band_solve": (None, (ctypes.c_int, ctypes.c_int, _POINTER, _POINTER, _POINTER)),
    "band_product": (None, (ctypes.c_int, ctypes.c_int, _POINTER, _POINTER, _POINTER)),
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
        self._factors = np.zeros((3 * width + 1, size), order="F")
        self._pivots = np.zeros(size, dtype=np.intc)

    def factor(self, matrix: np.ndarray) -> bool:
        """Factorise; False where a pivot is exactly zero. The matrix is kept for `product` and must not be written to afterwards."""
        self._matrix = matrix
        self._factors[: self._width] = 0.0
        self._factors[self._width :] = matrix
        return self._library.band_factor(self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data) == 0

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for right (size,) or (size, m), refined once by its own residual."""
        if right.ndim == 2:
            return np.stack([self.solve(column) for column in right.T], axis=1)
        found = self._back(right)
        return found + self._back(right - self.product(found))

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the last factorisation times x (size,)."""
        x, y = np.ascontiguousarray(x, dtype=np.float64), np.empty(self._size)
        self._library.band_product(self._size, self._width, self._matrix.ctypes.data, x.ctypes.data, y.ctypes.data)
        return y

    def _back(self, right: np.ndarray) -> np.ndarray:
        x = np.array(right, dtype=np.float64)
        self._library.band_solve(self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data, x.ctypes.data)
        return x
