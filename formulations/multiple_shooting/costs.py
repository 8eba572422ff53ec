"""Running and final cost of a scene with first and second derivatives, for all steps at once, and its goal as an augmented Lagrangian."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.scene import Scene
from models.scene.goal import goal_state, miss


class GoalTerm:
    """The goal as an augmented Lagrangian, y'm + weight/2 |m|^2 with m = x_T - goal, 0 where the end is free. y (2*nq,): multipliers, from zero."""

    def __init__(self, scene: Scene, weight: float) -> None:
        self._goal = goal_state(scene.task)
        self._given = ~np.isnan(self._goal)
        self.multipliers = np.zeros(len(self._goal))
        self.weight = weight

    @property
    def any(self) -> bool:
        """Whether a component of the end is given."""
        return bool(self._given.any())

    def miss(self, end: np.ndarray) -> np.ndarray:
        """Give end - goal (2*nq,) [m, rad, m/s, rad/s] of an end (2*nq,) [m, rad, m/s, rad/s]."""
        return miss(end, self._goal)

    def value(self, end: np.ndarray) -> float:
        """Evaluate the term at an end (2*nq,) [m, rad, m/s, rad/s]."""
        m = self.miss(end)
        return float(self.multipliers @ m + 0.5 * self.weight * m @ m)

    def slope(self, end: np.ndarray) -> np.ndarray:
        """Differentiate the term at an end (2*nq,) [m, rad, m/s, rad/s]: (2*nq,) [1/m, 1/rad, s/m, s/rad]."""
        return np.where(self._given, self.multipliers + self.weight * self.miss(end), 0.0)

    def hessian(self) -> np.ndarray:
        """Give its second derivatives: (2*nq, 2*nq) [-]."""
        return np.diag(np.where(self._given, self.weight, 0.0))

    def update(self, end: np.ndarray) -> None:
        """Update the multipliers to first order, y <- y + weight (x_T - goal), at an end (2*nq,) [m, rad, m/s, rad/s]."""
        self.multipliers += np.where(self._given, self.weight * self.miss(end), 0.0)


class Costs:
    """Running and final cost of a scene: values, slopes and Hessians, the Hessians made positive semidefinite."""

    def __init__(self, scene: Scene) -> None:
        d = derive(scene)
        state, inputs = [*d.q, *d.v], list(d.u)
        values = scene.parameter_values
        running, final = sp.sympify(d.running_cost).xreplace(values), sp.sympify(d.final_cost).xreplace(values)
        self._nx, self._nu = len(state), len(inputs)
        self._running = _Derivatives(running, [*state, *inputs])
        self._final = _Derivatives(final, state)

    def value(self, x: np.ndarray, u: np.ndarray) -> float:
        """Evaluate the cost of nodes x (steps+1, nx) [m, rad, m/s, rad/s] and inputs u (steps, nu) [N, N m]."""
        return float(self._running.value(np.hstack([x[:-1], u])).sum() + self._final.value(x[-1:])[0])

    def running(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give the slope (steps, nx+nu) [-] and Hessian (steps, nx+nu, nx+nu) [-] of the running cost at x (steps, nx), u (steps, nu) [SI]."""
        point = np.hstack([x, u])
        return self._running.slope(point), self._running.hessian(point)

    def final(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give the slope (nx,) [-] and Hessian (nx, nx) [-] of the final cost at x (nx,) [m, rad, m/s, rad/s]."""
        point = x[None, :]
        return self._final.slope(point)[0], self._final.hessian(point)[0]


class _Derivatives:
    def __init__(self, expression: sp.Expr, symbols: Sequence[sp.Symbol]) -> None:
        n = len(symbols)
        slope = [sp.diff(expression, symbol) for symbol in symbols]
        hessian = [sp.diff(entry, symbol) for entry in slope for symbol in symbols]
        self._n = n
        self._value, self._slope, self._hessian = (_rows(entries, symbols) for entries in ([expression], slope, hessian))
        self._quadratic = not any(entry.free_symbols for entry in hessian)

    def value(self, point: np.ndarray) -> np.ndarray:
        """Evaluate at points (n, symbols) [SI]: (n,) [-]."""
        return self._value(point)[:, 0]

    def slope(self, point: np.ndarray) -> np.ndarray:
        """Differentiate at points (n, symbols) [SI]: (n, symbols) [-]."""
        return self._slope(point)

    def hessian(self, point: np.ndarray) -> np.ndarray:
        """Differentiate twice at points (n, symbols) [SI], made positive semidefinite: (n, symbols, symbols) [-]."""
        rows = self._hessian(point[:1] if self._quadratic else point).reshape(-1, self._n, self._n)
        value, vectors = np.linalg.eigh(rows)
        convex = (vectors * np.maximum(value, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1) if (value < 0.0).any() else rows
        return np.broadcast_to(convex, (len(point), self._n, self._n))


def _rows(entries: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]) -> Callable[[np.ndarray], np.ndarray]:
    """A function of points (n, len(symbols)) to (n, len(entries)), constants spread over the rows."""
    compiled = sp.lambdify([list(symbols)], list(entries), modules=[np], cse=True)

    def function(point: np.ndarray) -> np.ndarray:
        """Evaluate the entries at points (n, symbols) [SI]: (n, entries) [-]."""
        found = np.empty((len(point), len(entries)))
        for index, column in enumerate(compiled(list(point.T))):
            found[:, index] = column
        return found

    return function
