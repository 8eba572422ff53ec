"""The functions as a back end calls them: one evaluation a point, time counted, numbers that are not finite reported as an error."""

from __future__ import annotations

import time

import numpy as np

from formulations.ipopt.problem import IpoptProblem


class Evaluations:
    """Caches values and first derivatives of the last point; `error` is what the back end understands as 'cut the step'."""

    def __init__(self, problem: IpoptProblem, error: type[Exception]) -> None:
        self._problem = problem
        self._error = error
        self._x_rows = self._x_entries = np.full(problem.n, np.nan)
        self._rows = self._entries = np.empty(0)
        self.seconds = 0.0
        self.calls = {"values": 0, "derivatives": 0, "hessians": 0}
        self.jacobianstructure = problem.jacobianstructure
        self.hessianstructure = problem.hessianstructure

    def _finite(self, values, what: str):
        if not np.all(np.isfinite(values)):
            raise self._error(f"{what} is not a finite number at this point")
        return values

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

    def objective(self, x: np.ndarray) -> float:
        return self._finite(self._values(x)[0], "the objective")

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return self._finite(self._values(x)[1], "a constraint")

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self._finite(self._derivatives(x)[0], "the gradient")

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._finite(self._derivatives(x)[1], "the Jacobian")

    def hessian(self, x: np.ndarray, lagrange: np.ndarray, factor: float) -> np.ndarray:
        begin = time.perf_counter()
        values = self._problem.hessian(x, lagrange, factor)
        self.calls["hessians"] += 1
        self.seconds += time.perf_counter() - begin
        return self._finite(values, "the Hessian")
