"""The functions as cyipopt calls them: one evaluation a point, time counted, numbers that are not finite reported, no exception lost.

cyipopt forgets what the Hessian raises: Ctrl-C there is swallowed and the solve runs on. So the first unexpected error of any callback is kept here,
the solve is stopped at the next iteration, and `run` raises the error afterwards, as it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from cyipopt import CyIpoptEvaluationError

from formulations.ipopt.problem import IpoptProblem


def _keeping(function: Callable[..., Any]) -> Callable[..., Any]:
    """The method, raising nothing but what Ipopt understands as 'cut the step'."""

    @wraps(function)
    def call(self: Evaluations, *arguments: Any) -> Any:
        if self.error is None:
            try:
                return function(self, *arguments)
            except CyIpoptEvaluationError:
                raise
            except BaseException as error:  # noqa: BLE001 - kept and raised after the solve, KeyboardInterrupt too
                self.error = error
        raise CyIpoptEvaluationError("the solve is being stopped")

    return call


def _finite(values: Any, what: str) -> Any:
    if not np.all(np.isfinite(values)):
        raise CyIpoptEvaluationError(f"{what} is not a finite number at this point")
    return values


class Evaluations:
    """Caches values and first derivatives of the last point; `after` is asked after each iteration whether to go on."""

    def __init__(self, problem: IpoptProblem, after: Callable[..., bool]) -> None:
        self._problem = problem
        self._after = after
        self._x_rows = self._x_entries = np.full(problem.n, np.nan)
        self._rows = self._entries = np.empty(0)
        self.error: BaseException | None = None
        self.seconds = 0.0
        self.calls = {"values": 0, "derivatives": 0, "hessians": 0}
        self.jacobianstructure = problem.jacobianstructure
        self.hessianstructure = problem.hessianstructure

    def _values(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        if not np.array_equal(x, self._x_rows):
            begin = time.perf_counter()
            self._rows = self._problem.rows_at(x)
            self._x_rows = x.copy()
            self.calls["values"] += 1
            self.seconds += time.perf_counter() - begin
        return self._problem.split_rows(self._rows)

    def _derivatives(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not np.array_equal(x, self._x_entries):
            begin = time.perf_counter()
            self._entries = self._problem.entries_at(x)
            self._x_entries = x.copy()
            self.calls["derivatives"] += 1
            self.seconds += time.perf_counter() - begin
        return self._problem.split_entries(self._entries)

    @_keeping
    def objective(self, x: np.ndarray) -> float:
        return _finite(self._values(x)[0], "the objective")

    @_keeping
    def constraints(self, x: np.ndarray) -> np.ndarray:
        return _finite(self._values(x)[1], "a constraint")

    @_keeping
    def gradient(self, x: np.ndarray) -> np.ndarray:
        return _finite(self._derivatives(x)[0], "the gradient")

    @_keeping
    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return _finite(self._derivatives(x)[1], "the Jacobian")

    @_keeping
    def hessian(self, x: np.ndarray, lagrange: np.ndarray, factor: float) -> np.ndarray:
        begin = time.perf_counter()
        values = self._problem.hessian(x, lagrange, factor)
        self.calls["hessians"] += 1
        self.seconds += time.perf_counter() - begin
        return _finite(values, "the Hessian")

    def intermediate(self, *numbers: Any) -> bool:
        """Ipopt's question after each iteration, whether to go on."""
        if self.error is None:
            try:
                return self._after(*numbers)
            except BaseException as error:  # noqa: BLE001 - as above
                self.error = error
        return False
