"""Banded LU with row pivoting in compiled C: milliseconds for a plan of some hundred steps, always one thread.

    band = BandedLU(size, width)
    band.factor(matrix)                 # (2*width + 1, size), Fortran order: entry (i, j) at [width + i - j, j]; False where singular
    x = band.solve(right)               # right (size,) or (size, m)

A matrix whose first columns are those of the matrix before is factorised from the first column that differs, to the same bits as in full: windows of
contact that move late in a plan leave what comes before them as it is.

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
_INT, _POINTER = ctypes.c_int, ctypes.c_void_p
_SIGNATURES = {
    "band_common": (_INT, (_INT, _INT, _POINTER, _POINTER)),
    "band_factor": (_INT, (_INT, _INT, _POINTER, _POINTER, _INT)),
    "band_gather": (None, (_INT, _INT, _INT, _INT, _INT, _POINTER, _INT, _POINTER)),
    "band_solve": (None, (_INT, _POINTER, _POINTER, _POINTER, _POINTER)),
    "band_product": (None, (_INT, _POINTER, _POINTER, _POINTER)),
    "band_solve_several": (None, (_INT, _INT, _POINTER, _POINTER, _POINTER, _POINTER)),
    "band_product_several": (None, (_INT, _INT, _POINTER, _POINTER, _POINTER)),
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


class _Lists(ctypes.Structure):
    _fields_ = (("starts", _POINTER), ("rows", _POINTER), ("values", _POINTER))


class _Nonzeros:
    """The nonzeros of the rows top <= row < bottom of a band, column by column; shift: the band's row of the diagonal."""

    def __init__(self, size: int, shift: int, top: int, bottom: int) -> None:
        self._size, self._part = size, (shift, top, bottom)
        most = size * (bottom - top) + 1  # one more is written to
        self._arrays = np.zeros(size + 1, dtype=np.intc), np.empty(most, dtype=np.intc), np.empty(most)
        self._lists = _Lists(*(array.ctypes.data for array in self._arrays))
        self.pointer = ctypes.addressof(self._lists)

    def gather(self, library: ctypes.CDLL, band: np.ndarray, first: int) -> None:
        library.band_gather(self._size, len(band), *self._part, band.ctypes.data, first, self.pointer)


class BandedLU:
    """See the module docstring."""

    def __init__(self, size: int, width: int) -> None:
        self._size, self._width = size, width
        self._library = _library()
        self._matrix: np.ndarray | None = None  # that the factors are of
        self._factors = np.zeros((3 * width + 1, size), order="F")
        self._pivots = np.zeros(size, dtype=np.intc)
        self._entries = _Nonzeros(size, width, 0, 2 * width + 1)
        self._lower, self._upper = _Nonzeros(size, 2 * width, 2 * width + 1, 3 * width + 1), _Nonzeros(size, 2 * width, 0, 2 * width + 1)

    def factor(self, matrix: np.ndarray) -> bool:
        """Factorise; False where a pivot is exactly zero. The matrix is kept, and must not be written to afterwards."""
        first, before, self._matrix = 0, self._matrix, None
        if before is not None:
            first = self._library.band_common(self._size, len(matrix), before.ctypes.data, matrix.ctypes.data)
        self._factors[: self._width, first:] = 0.0
        self._factors[self._width :, first:] = matrix[:, first:]
        if self._library.band_factor(self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data, first) != 0:
            return False
        for lists, band in ((self._entries, matrix), (self._lower, self._factors), (self._upper, self._factors)):
            lists.gather(self._library, band, first)
        self._matrix = matrix
        return True

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for right (size,) or (size, m), refined once by its own residual."""
        found = self._back(right)
        return found + self._back(right - self.product(found))

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the last factorisation times x (size,) or (size, m)."""
        x = np.ascontiguousarray(x, dtype=np.float64)
        y, matrix = np.empty(x.shape), self._entries.pointer
        if x.ndim == 1:
            self._library.band_product(self._size, matrix, x.ctypes.data, y.ctypes.data)
        else:
            self._library.band_product_several(self._size, x.shape[1], matrix, x.ctypes.data, y.ctypes.data)
        return y

    def _back(self, right: np.ndarray) -> np.ndarray:
        x = np.array(right, dtype=np.float64, order="C")
        factors = (self._pivots.ctypes.data, self._lower.pointer, self._upper.pointer, x.ctypes.data)
        if x.ndim == 1:
            self._library.band_solve(self._size, *factors)
        else:
            self._library.band_solve_several(self._size, x.shape[1], *factors)
        return x
