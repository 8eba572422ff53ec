"""The optimality conditions of a plan with fixed contact modes, as one banded matrix, factorised in milliseconds.

Unknowns, time by time: y[t] (multipliers of the time step), u[t], z[t+1], mu[t+1] (multipliers of phi = 0 where that is imposed), and w, the
multipliers of the goal, last. All that a change of modes or active bounds does is change numbers in the band: its shape is settled once.

    kkt = BandedKKT(linear)
    kkt.factor(closed, held, touching)             # which contacts push, which inputs lie on a bound, where phi = 0 is imposed
    point = kkt.solve(kkt.right_side(closed, held, bound, touching, goal))

Lagrangian: L = sum_t cost(z[t], u[t]) + y[t]' (A[t] z[t] + B u[t] + c[t] - z[t+1]) + mu[t]' (P z[t] + p) + w' (z[T] - goal).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formulations.windows.band import BandedLU
from formulations.windows.linear_scene import LinearScene


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """A solution of the optimality system: z (steps+1, n), u (steps, nu), y (steps, n), mu (steps, nc) with mu[0] = 0, w (n,)."""

    z: np.ndarray
    u: np.ndarray
    y: np.ndarray
    mu: np.ndarray
    w: np.ndarray


class BandedKKT:
    """See the module docstring."""

    def __init__(self, linear: LinearScene) -> None:
        self._linear = linear
        n, nu, nc, T = linear.n, linear.nu, linear.nc, linear.steps
        self._block = 2 * n + nu + nc
        self.size = T * self._block + n
        block = self._block * np.arange(T)[:, None]
        self._y, self.rows_u = block + np.arange(n), block + n + np.arange(nu)
        self.rows_z, self.rows_mu = block + n + nu + np.arange(n), block + 2 * n + nu + np.arange(nc)  # row t: z[t+1], mu[t+1]
        self.rows_w = T * self._block + np.arange(n)
        self._closing = np.einsum("ic,c,cj->cij", linear.E, linear.k, linear.P)  # what a closed contact adds to A
        self._settle_band()

    def _settle_band(self) -> None:
        """The constant part of the matrix, and the places of what changes."""
        lin, n = self._linear, self._linear.n
        q, s, r = lin.H[:n, :n], lin.H[:n, n:], lin.H[n:, n:]
        ones = np.eye(n)
        entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

        def add(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> None:
            """The same dense block at each time: rows (times, a), columns (times, b), values (a, b)."""
            i, j = np.nonzero(values)
            at = np.broadcast_to(values[i, j], (len(rows), len(i)))
            entries.append((rows[:, i].ravel(), columns[:, j].ravel(), at.ravel()))

        add(self._y, self.rows_z, -ones)
        add(self.rows_z, self._y, -ones)
        add(self._y, self.rows_u, lin.B)
        add(self.rows_z[:-1], self.rows_z[:-1], q)
        add(self.rows_z[:-1], self.rows_u[1:], s)
        add(self.rows_z[:-1], self.rows_mu[:-1], lin.P.T)
        aimed = np.diag(lin.aimed.astype(float))  # a free component of the end has no multiplier: w = 0
        add(self.rows_z[-1:], self.rows_w[None], aimed)
        add(self.rows_w[None], self.rows_z[-1:], aimed)
        add(self.rows_w[None], self.rows_w[None], ones - aimed)
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))

        pattern = (lin.A != 0) | (self._closing != 0).any(axis=0)
        self._step = np.nonzero(pattern)
        i, j = self._step
        forward = self._y[1:, i], self.rows_z[:-1, j]
        held = [(self.rows_u, self.rows_u, r), (self.rows_u, self._y, lin.B.T), (self.rows_u[1:], self.rows_z[:-1], s.T)]
        moving = [forward, *((a[:, v.nonzero()[0]], b[:, v.nonzero()[1]]) for a, b, v in held)]
        moving += [
            (self.rows_u, self.rows_u),
            (self.rows_mu[:-1, lin.P.nonzero()[0]], self.rows_z[:-1, lin.P.nonzero()[1]]),
            (self.rows_mu, self.rows_mu),
        ]
        reach = [rows - columns, *((a - b).ravel() for a, b in moving)]
        width = max(int(np.abs(part).max(initial=0)) for part in reach)
        self._width, self._height = width, 2 * width + 1  # as many diagonals below as above
        self._lu = BandedLU(self.size, width)
        self._constant = np.zeros((self._height, self.size), order="F")
        flat = self._constant.reshape(-1, order="F")
        np.add.at(flat, self._place(rows, columns), values)
        self._at_forward, self._at_backward = self._place(*forward), self._place(forward[1], forward[0])
        self._at_held = [(self._place(a[:, v.nonzero()[0]], b[:, v.nonzero()[1]]), v.nonzero()[0], v[v.nonzero()]) for a, b, v in held]
        self._at_u = self._place(self.rows_u, self.rows_u)
        self._at_touch = self._place(self.rows_mu[:-1, lin.P.nonzero()[0]], self.rows_z[:-1, lin.P.nonzero()[1]])
        self._at_mu = self._place(self.rows_mu, self.rows_mu)
        self._at_w = self._place(self.rows_w, self.rows_w)

    def _place(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Positions in the band, column by column (Fortran order)."""
        return columns * self._height + self._width + rows - columns

    def transition(self, closed: np.ndarray) -> np.ndarray:
        """A[t] (rows, n, n) with the contacts of closed (rows, nc) pushing."""
        return self._linear.A + np.tensordot(closed.astype(float), self._closing, axes=1)

    def drift(self, closed: np.ndarray) -> np.ndarray:
        """c[t] (steps, n)."""
        return self._linear.c + (closed * (self._linear.k * self._linear.p)) @ self._linear.E.T

    def factor(self, closed: np.ndarray, held: np.ndarray, touching: np.ndarray, *, softness: float = 0.0) -> bool:
        """Factorise with these closed contacts (steps, nc), inputs held on a bound (steps, nu) and phi = 0 imposed (steps, nc; row 0 unused).

        softness: instead of z[T] = goal, the cost 1/2 |z[T] - goal|^2 / softness is added.
        False where the matrix is singular: the goal cannot be steered to, or conditions contradict each other.
        """
        band = self._constant.copy(order="F")
        flat = band.reshape(-1, order="F")
        i, j = self._step
        slopes = self._linear.A[i, j] + closed[1:].astype(float) @ self._closing[:, i, j]
        flat[self._at_forward] = slopes
        flat[self._at_backward] += slopes
        free = (~held).astype(float)
        for place, row, value in self._at_held:
            late = free if len(place) == len(free) else free[1:]
            flat[place] += late[:, row] * value
        flat[self._at_u] += held
        imposed = np.vstack([touching[1:], np.zeros((1, touching.shape[1]), dtype=bool)])
        contact, state = self._linear.P.nonzero()
        flat[self._at_touch] += imposed[:-1, contact] * self._linear.P[contact, state]
        flat[self._at_mu] += ~imposed
        flat[self._at_w] -= softness * self._linear.aimed
        return self._lu.factor(band)

    def right_side(self, closed: np.ndarray, held: np.ndarray, bound: np.ndarray, touching: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """(size,) right-hand side; bound (steps, nu): the values of held inputs; goal (n,): where z[T] is to be."""
        lin, n = self._linear, self._linear.n
        right = np.zeros(self.size)
        step = -self.drift(closed)
        step[0] -= self.transition(closed[:1])[0] @ lin.start
        slope = np.tile(-lin.g[n:], (lin.steps, 1))
        slope[0] -= lin.H[n:, :n] @ lin.start
        right[self._y], right[self.rows_u] = step, np.where(held, bound, slope)
        right[self.rows_z[:-1]] = -lin.g[:n]
        right[self.rows_mu[:-1]] = np.where(touching[1:], -lin.p, 0.0)
        right[self.rows_w] = np.where(lin.aimed, goal, 0.0)
        return right

    def goal_columns(self) -> np.ndarray:
        """(size, number of given components) right-hand sides of a goal moved by one in each of their directions."""
        rows = self.rows_w[self._linear.aimed]
        columns = np.zeros((self.size, len(rows)), order="F")
        columns[rows, np.arange(len(rows))] = 1.0
        return columns

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for right (size,) or (size, m), refined once by its own residual."""
        return self._lu.solve(right)

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the last factorisation times x (size,)."""
        return self._lu.product(x)

    def point(self, x: np.ndarray) -> Point:
        """A solution by name."""
        lin = self._linear
        return Point(
            z=np.vstack([lin.start, x[self.rows_z]]),
            u=x[self.rows_u],
            y=x[self._y],
            mu=np.vstack([np.zeros((1, lin.nc)), x[self.rows_mu[:-1]]]),
            w=x[self.rows_w],
        )
