"""The loss, its mean over random inputs, and the loop of gradient descent in compiled C (loss.c): a thousand iterations are one call.

    loss = CompiledLoss(objective)
    loss.mean(u, noise, gradient)                  # u (steps, nu), noise (samples, steps, nu)
    run = DescentRun(loss, u0, settings, ...)
    while run.advance(1000) is Ending.UNDER_WAY: ...

It works in the buffers of the objective's workspace, so that its last rollout is there to be looked at. The values are those of `Objective`, bit for bit.
"""

from __future__ import annotations

import ctypes
from enum import IntEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler
from models.codegen.kernel import KernelError

if TYPE_CHECKING:
    from formulations.shooting.objective import Objective

_SOURCE = Path(__file__).with_name("loss.c")
_OPTIMISED = ("-O3",)
_INT, _DOUBLE, _POINTER = ctypes.c_int, ctypes.c_double, ctypes.c_void_p
_FIRST_ROOM = 256  # rows of history; doubled when they are full
_EVALUATED, _DIVERGED, _INDEFINITE = range(3)


class Ending(IntEnum):
    """Where a descent stands, as loss.c numbers it."""

    UNDER_WAY = 0
    SETTLED = 1
    RUNAWAY = 2
    AT_LIMIT = 3
    NOT_FINITE = 4
    INDEFINITE = 5


class _LossData(ctypes.Structure):
    _fields_ = (
        *((name, _POINTER) for name in ("rollout", "adjoint", "cost")),
        *((name, _INT) for name in ("steps", "nq", "nu", "law")),
        *((name, _DOUBLE) for name in ("h", "b", "terminal", "running")),
        *(
            (name, _POINTER)
            for name in ("parameters", "start", "goal", "u", "q", "v", "lam", "q_bar", "v_bar", "u_bar", "start_bar", "error")
        ),
        *((name, _DOUBLE) for name in ("value", "squares", "last_cost")),
        ("finite_steps", _INT),
    )


class _DescentData(ctypes.Structure):
    _fields_ = (
        *((name, _DOUBLE) for name in ("rate", "tolerance")),
        *((name, _INT) for name in ("limit", "by_rule", "count", "capacity")),
        *((name, _POINTER) for name in ("lower", "upper", "losses", "terminal_errors", "costs", "norms", "best", "best_u")),
    )


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Compiled once and cached on disk. Raises MachineError without a compiler."""
    compiler, text = find_compiler(), _SOURCE.read_text(encoding="utf-8")
    key = "\n".join([compiler.describe(), " ".join((*FLAGS, *_OPTIMISED)), text])
    made = ctypes.CDLL(str(cached(key, ".so", lambda path: compile_shared(compiler, {"loss.c": text}, path, extra_flags=_OPTIMISED))))
    made.loss_mean.restype = made.descent_run.restype = made.loss_progress.restype = _INT
    made.loss_mean.argtypes = [ctypes.POINTER(_LossData), _INT, *[_POINTER] * 2, ctypes.POINTER(_DOUBLE), _POINTER]
    made.descent_run.argtypes = [ctypes.POINTER(_LossData), ctypes.POINTER(_DescentData), _INT]
    made.loss_progress.argtypes = [_INT, _POINTER, _POINTER, _DOUBLE]
    return made


class CompiledLoss:
    """An objective as loss.c sees it: its workspace's buffers, and its goal and weights as they are at each call."""

    def __init__(self, objective: Objective) -> None:
        work = objective.work
        self.objective = objective
        self.data = _LossData(
            steps=work.steps, nq=work.kernel.scene.nq, nu=work.kernel.scene.nu, law=work.law.value, h=work.step, b=work.sharpness
        )
        for name, function in work.functions._asdict().items():
            setattr(self.data, name, ctypes.cast(function, _POINTER))
        for name in ("start", "u", "q", "v", "lam", "q_bar", "v_bar", "u_bar", "start_bar"):
            setattr(self.data, name, getattr(work, name).ctypes.data)
        self.data.parameters = work.kernel.parameters_of(work.step).ctypes.data
        self.data.goal, self.data.error = objective.goal.ctypes.data, objective.error.ctypes.data
        self.use_weights()

    def use_weights(self) -> None:
        """Take the objective's weights, which may have been replaced since."""
        self.data.terminal, self.data.running = self.objective.weights.terminal, self.objective.weights.running

    def mean(self, u: np.ndarray, noise: np.ndarray, gradient: np.ndarray) -> float:
        """Mean of the loss over inputs u (steps, nu) + noise (samples, steps, nu), and of its gradient, written to gradient (steps, nu).

        Infinite where one of them diverges. Raises KernelError as `Objective.gradient` does.
        """
        self.use_weights()
        mean = _DOUBLE()
        u = np.ascontiguousarray(u, dtype=np.float64)
        found = library().loss_mean(
            ctypes.byref(self.data), len(noise), u.ctypes.data, noise.ctypes.data, ctypes.byref(mean), gradient.ctypes.data
        )
        if found == _INDEFINITE:
            raise self.indefinite()
        return mean.value if found == _EVALUATED else np.inf

    def indefinite(self) -> KernelError:
        scene = self.objective.work.kernel.scene
        return KernelError(f"scene {scene.name}: the mass matrix is not positive definite along the rollout.")


class DescentRun:
    """Gradient descent from u0 (steps, nu), which must be within the bounds, until it ends or `advance` has gone as far as it was told.

    best (steps, nu): the inputs of the least loss so far; u: those of the last evaluation, in the objective's workspace. limit: most steps; lower,
    upper (nu,); tolerance: of the stopping rule, None for a descent that only the limit ends.
    """

    def __init__(
        self, loss: CompiledLoss, u0: np.ndarray, *, rate: float, limit: int, tolerance: float | None, lower: np.ndarray, upper: np.ndarray
    ) -> None:
        self._loss = loss
        loss.use_weights()
        self.u = loss.objective.work.u
        np.copyto(self.u, u0)
        self.best = self.u.copy()
        self._bounds = [np.broadcast_to(bound, self.u.shape).copy() for bound in (lower, upper)]
        self._data = _DescentData(rate=rate, tolerance=tolerance or 0.0, limit=min(limit, 2**31 - 1), by_rule=tolerance is not None)
        self._data.lower, self._data.upper = (bound.ctypes.data for bound in self._bounds)
        self._data.best_u = self.best.ctypes.data
        self._columns = np.empty((5, 0))  # loss, terminal error, cost, norm of the gradient, least loss so far
        self._make_room()

    @property
    def evaluations(self) -> int:
        return self._data.count

    @property
    def columns(self) -> np.ndarray:
        """(4, evaluations): loss, terminal error, cost and norm of the gradient at each evaluation."""
        return self._columns[:4, : self._data.count]

    def advance(self, most: int) -> Ending:
        """At most `most` evaluations more. Raises KernelError where a mass matrix is not positive definite."""
        self._make_room()
        ending = Ending(library().descent_run(ctypes.byref(self._loss.data), ctypes.byref(self._data), most))
        if ending is Ending.INDEFINITE:
            raise self._loss.indefinite()
        return ending

    def _make_room(self) -> None:
        count, room = self._data.count, self._columns.shape[1]
        if count < room:
            return
        columns = np.empty((5, max(_FIRST_ROOM, 2 * room)))
        columns[:, :count] = self._columns[:, :count]
        self._columns, self._data.capacity = columns, columns.shape[1]
        for name, column in zip(("losses", "terminal_errors", "costs", "norms", "best"), columns, strict=True):
            setattr(self._data, name, column.ctypes.data)
