"""The linear-quadratic subproblem of multiple shooting, in compiled C: linear in the number of stages.

    stages = Stages(steps, nx, nu)
    stages.A, stages.B, stages.gap, stages.lx ...      # filled in by the caller
    if stages.backward(u, lower, upper, shift=0.0): stages.k, stages.K, stages.Vx
    dx, du = stages.forward()

The recursion is that of iLQR with gaps between the nodes; the bounds of the inputs are met stage by stage by a small quadratic program
(Tassa, Mansard and Todorov, Control-Limited Differential Dynamic Programming, ICRA 2014; gaps as in Mastalli et al., Crocoddyl, ICRA 2020).
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler

_SOURCE = Path(__file__).with_name("riccati.c")
_POINTER, _INT, _DOUBLE = ctypes.c_void_p, ctypes.c_int, ctypes.c_double


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """Compiled once and cached on disk. Raises MachineError without a compiler."""
    compiler, text = find_compiler(), _SOURCE.read_text(encoding="utf-8")
    key = "\n".join([compiler.describe(), " ".join(FLAGS), text])
    library = ctypes.CDLL(str(cached(key, ".so", lambda path: compile_shared(compiler, {"riccati.c": text}, path))))
    library.riccati_work.restype, library.riccati_work.argtypes = _INT, [_INT, _INT]
    library.riccati_backward.restype = _INT
    library.riccati_backward.argtypes = [_INT, _INT, _INT, *[_POINTER] * 8, _DOUBLE, *[_POINTER] * 9]
    library.riccati_forward.restype, library.riccati_forward.argtypes = None, [_INT, _INT, _INT, *[_POINTER] * 7]
    return library


class Stages:
    """The data of the subproblem, and its solution; see the module docstring and riccati.c.

    A (steps, nx, nx), B (steps, nx, nu), gap (steps, nx): the linearised steps; lx (steps, nx), lu (steps, nu), lxx (steps, nx, nx),
    lux (steps, nu, nx), luu (steps, nu, nu): the cost of the stages; px (nx,), pxx (nx, nx): that of the end.
    k (steps, nu), K (steps, nu, nx): du = k + K dx; Vx (steps+1, nx): slope of the value, which is the multiplier of each gap.
    """

    def __init__(self, steps: int, nx: int, nu: int) -> None:
        self.steps, self.nx, self.nu = steps, nx, nu
        self.A, self.B, self.gap = np.zeros((steps, nx, nx)), np.zeros((steps, nx, nu)), np.zeros((steps, nx))
        self.lx, self.lu = np.zeros((steps, nx)), np.zeros((steps, nu))
        self.lxx, self.lux, self.luu = np.zeros((steps, nx, nx)), np.zeros((steps, nu, nx)), np.zeros((steps, nu, nu))
        self.px, self.pxx = np.zeros(nx), np.zeros((nx, nx))
        self.k, self.K, self.Vx = np.zeros((steps, nu)), np.zeros((steps, nu, nx)), np.zeros((steps + 1, nx))
        self._library = _library()
        self._room = np.zeros(self._library.riccati_work(nx, nu))
        self._held = np.zeros(nu, dtype=np.intc)

    def backward(self, u: np.ndarray, lower: np.ndarray, upper: np.ndarray, shift: float) -> bool:
        """Fill k, K, Vx for inputs u (steps, nu) with bounds (nu,); False where a Hessian is not positive definite (try a larger shift)."""
        self.Vx[-1] = self.px
        hessian = self.pxx.copy()
        given = (self.A, self.B, self.gap, self.lx, self.lu, self.lxx, self.lux, self.luu)
        inputs = [np.ascontiguousarray(array, dtype=np.float64) for array in (u, lower, upper)]
        rest = (*inputs, self.Vx, hessian, self.k, self.K, self._room, self._held)
        failed = self._library.riccati_backward(
            self.steps, self.nx, self.nu, *(a.ctypes.data for a in given), shift, *(a.ctypes.data for a in rest)
        )
        return failed == 0

    def forward(self, gap: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """dx (steps+1, nx) and du (steps, nu) of the linearised stages under k and K; with a gap (steps, nx) of one's own: under K alone."""
        dx, du = np.zeros((self.steps + 1, self.nx)), np.zeros((self.steps, self.nu))
        arrays = (self.A, self.B, self.gap, self.k, self.K, dx, du)
        if gap is not None:
            arrays = (self.A, self.B, np.ascontiguousarray(gap), np.zeros_like(self.k), self.K, dx, du)
        self._library.riccati_forward(self.steps, self.nx, self.nu, *(array.ctypes.data for array in arrays))
        return dx, du
