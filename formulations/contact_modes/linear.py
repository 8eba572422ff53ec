"""The matrices of a linear scene, and the optimality conditions of fixed modes as a banded matrix.

    linear.A @ z + linear.B @ u + linear.c + linear.E @ lam  # the next state z = (q, v)
    kkt.factor(closed, held, touching)
    point = kkt.point(kkt.solve(kkt.right_side(closed, held, bound, touching)))

lam_i = k_i phi_i(z) where contact i is closed; the running cost is 1/2 x' H x + g' x + constant
with x = (q, v, u). Unknowns, time by time: y[t], u[t], z[t+1], mu[t+1]; last w. Lagrangian:

    L = sum_t cost(z[t], u[t]) + y[t]' (A[t] z[t] + B u[t] + c[t] - z[t+1])
      + mu[t]' (P z[t] + p) + w' (z[T] - goal)
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import sympy as sp

from formulations.grids import input_bounds
from models.codegen.compiler import cached_library, load_library
from models.dynamics import Dynamics, derive
from models.scene import Scene
from models.scene.goal import goal_state, miss

_SOURCE = Path(__file__).with_name("band.c")
_SIGNATURES = {
    "band_factor": ("n", "nnpp"),
    "band_solve": ("", "nnppp"),
    "band_product": ("", "nnppp"),
}


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    return load_library(
        cached_library({"band.c": _SOURCE.read_text(encoding="utf-8")}, ("-O3",)), _SIGNATURES
    )


class BandedLU:
    """Banded LU with row pivoting; entry (i, j) of the matrix is at [width + i - j, j].

    LAPACK's gbtrf and gbtrs take 1.7 times the CPU of a whole three_cart solve: they call the BLAS
    twice per column for ten numbers, and unlimited BLAS threads spin.
    """

    def __init__(self, size: int, width: int) -> None:
        self._size, self._width = size, width
        self._library = _library()
        self._matrix = np.zeros((2 * width + 1, size), order="F")
        self._factors, self._pivots = (
            np.zeros((3 * width + 1, size), order="F"),
            np.zeros(size, dtype=np.intc),
        )

    def factor(self, matrix: np.ndarray) -> bool:
        """Factorise matrix (2*width + 1, size) [-] in Fortran order; return False for a zero pivot.

        The matrix is kept and must not change later. Raises ValueError for another shape.
        """
        self._matrix = np.asfortranarray(matrix, dtype=np.float64)
        self._factors[: self._width], self._factors[self._width :] = 0.0, matrix
        return (
            self._library.band_factor(
                self._size, self._width, self._factors.ctypes.data, self._pivots.ctypes.data
            )
            == 0
        )

    def solve(self, right: np.ndarray, *, refine: bool = True) -> np.ndarray:
        """Solve the factorised system for right (size,) [-], optionally refined once: (size,) [-].

        Raises nothing: the size is not checked.
        """
        x = self._back(right)
        return x + self._back(right - self.product(x)) if refine else x

    def product(self, x: np.ndarray) -> np.ndarray:
        """Multiply the last factorised matrix by x (size,) [-]: (size,) [-].

        Raises nothing: the size is not checked.
        """
        factor = np.ascontiguousarray(x, dtype=np.float64)
        product = np.empty_like(factor)
        self._library.band_product(
            self._size,
            self._width,
            self._matrix.ctypes.data,
            factor.ctypes.data,
            product.ctypes.data,
        )
        return product

    def _back(self, right: np.ndarray) -> np.ndarray:
        x = np.array(right, dtype=np.float64, order="C")  # solved in place
        self._library.band_solve(
            self._size,
            self._width,
            self._factors.ctypes.data,
            self._pivots.ctypes.data,
            x.ctypes.data,
        )
        return x


# Smallest eigenvalue of a convex Hessian relative to the largest one: rounding.
_CONVEX = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearScene:
    """The matrices of a linear scene with n = 2*nq states z = (q, v).

    - A (n, n), B (n, nu), c (n,), E (n, nc) [per N]: the time step
    - P (nc, n), p (nc,) [m]: phi = P z + p
    - k: (nc,) [N/m]
    - H (n+nu, n+nu), g (n+nu,), constant: the running cost
    - lower, upper: (nu,); start, goal: (n,), NaN for a free end
    - contacts: number of contacts among the nc rows of P; the rest are velocity bounds phi <= 0,
      with E = 0 and never closed
    """

    A: np.ndarray
    B: np.ndarray
    c: np.ndarray
    E: np.ndarray
    P: np.ndarray
    p: np.ndarray
    k: np.ndarray
    H: np.ndarray
    g: np.ndarray
    constant: float
    lower: np.ndarray
    upper: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    step: float
    steps: int
    contacts: int

    @property
    def aimed(self) -> np.ndarray:
        """Return whether each component of the end is given: (n,) [-]. Raises nothing."""
        return ~np.isnan(self.goal)

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.c)

    @property
    def nu(self) -> int:
        """Return the number of inputs."""
        return self.B.shape[1]

    @property
    def nc(self) -> int:
        """Return the number of contacts and velocity bounds."""
        return len(self.p)

    def penetration(self, z: np.ndarray) -> np.ndarray:
        """Return phi (rows, nc) [m] at states z (rows, n) [m, rad, m/s, rad/s].

        Raises ValueError for another number of states.
        """
        return z @ self.P.T + self.p

    def cost(self, z: np.ndarray, u: np.ndarray) -> float:
        """Sum the running cost over z (steps, n) [m, rad, m/s, rad/s] and u (steps, nu) [N, N m].

        Raises ValueError for an array of another shape.
        """
        x = np.hstack([z, u])
        return float(0.5 * ((x @ self.H) * x).sum() + (x @ self.g).sum() + self.constant * len(x))

    def soft_cost(self, point: Point, softness: float) -> float:
        """Return the cost of a point, including the error of a soft goal as in `ModesProblem`."""
        cost = self.cost(point.z[:-1], point.u)
        return (
            cost
            if softness == 0.0
            else cost + 0.5 / softness * float((miss(point.z[-1], self.goal) ** 2).sum())
        )


def is_linear(scene: Scene) -> bool:
    """Return whether fixed contact modes leave a convex quadratic program."""
    dynamics = derive(scene)
    if not dynamics.structure.linear or dynamics.final_cost != 0:
        return False
    hessian = _cost_hessian(dynamics)
    if hessian.free_symbols:
        return False  # the running cost is not quadratic
    eigenvalues = (
        np.linalg.eigvalsh(np.array(hessian, dtype=float)) if hessian.rows else np.zeros(1)
    )
    return bool(eigenvalues[0] >= -_CONVEX * max(1.0, eigenvalues[-1]))


def linear_scene(scene: Scene) -> LinearScene:
    """Return the matrices of a scene for which `is_linear` is true."""
    d, task, nq = derive(scene), scene.task, scene.nq
    inverse = np.linalg.inv(_numbers(d, d.mass_matrix))
    slope = {
        name: inverse @ _slopes(d, d.tau, symbols)
        for name, symbols in (("q", d.q), ("v", d.v), ("u", d.u))
    }
    rest = inverse @ _at_zero(d, d.tau)
    push = inverse @ _numbers(d, d.gap_jacobian).reshape(scene.nc, nq).T
    h, eye = task.step, np.eye(nq)
    velocity = np.hstack(
        [h * slope["q"], eye + h * slope["v"]]
    )  # v[t+1] = velocity z + ..., q[t+1] = q + h v[t+1]
    position = np.hstack([eye, np.zeros((nq, nq))]) + h * velocity
    x = [*d.q, *d.v, *d.u]
    cost = sp.Matrix([d.running_cost])
    (lower, upper), (P, p) = input_bounds(scene), _velocity_bounds(scene)
    return LinearScene(
        A=np.vstack([position, velocity]),
        B=np.vstack([h * h * slope["u"], h * slope["u"]]),
        c=np.concatenate([h * h * rest, h * rest]),
        E=np.hstack([np.vstack([h * h * push, h * push]), np.zeros((2 * nq, len(p)))]),
        P=np.vstack([np.hstack([_slopes(d, d.penetration, d.q), np.zeros((scene.nc, nq))]), P]),
        p=np.concatenate([_at_zero(d, d.penetration), p]),
        k=np.concatenate([_numbers(d, d.stiffness).ravel(), np.ones(len(p))]),
        H=np.array(_cost_hessian(d), dtype=float),
        g=_numbers(d, cost.jacobian(x).subs(dict.fromkeys(x, 0))).ravel(),
        constant=float(_at_zero(d, cost)[0]),
        lower=lower,
        upper=upper,
        start=np.array(task.start),
        goal=goal_state(task),
        step=h,
        steps=task.steps,
        contacts=scene.nc,
    )


def _velocity_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    rows, offsets = [], []
    for index, coordinate in enumerate(scene.coordinates):
        for sign, bound in ((-1.0, coordinate.velocity_lower), (1.0, coordinate.velocity_upper)):
            if np.isfinite(bound):
                rows.append(sign * np.eye(2 * scene.nq)[scene.nq + index])
                offsets.append(-sign * bound)
    return np.array(rows).reshape(len(rows), 2 * scene.nq), np.array(offsets)


def _cost_hessian(d: Dynamics) -> sp.Matrix:
    return sp.hessian(d.running_cost.subs(d.scene.parameter_values), [*d.q, *d.v, *d.u])


def _numbers(d: Dynamics, matrix: sp.Matrix) -> np.ndarray:
    return np.array(matrix.subs(d.scene.parameter_values), dtype=float).reshape(matrix.shape)


def _slopes(d: Dynamics, matrix: sp.Matrix, symbols: Sequence[sp.Symbol]) -> np.ndarray:
    return (
        _numbers(d, matrix.jacobian(list(symbols))) if matrix.rows else np.zeros((0, len(symbols)))
    )


def _at_zero(d: Dynamics, matrix: sp.Matrix) -> np.ndarray:
    return _numbers(d, matrix.subs(dict.fromkeys([*d.q, *d.v, *d.u], 0))).ravel()


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """A solution: z (steps+1, n), u (steps, nu), y (steps, n), mu (steps, nc) with mu[0] = 0."""

    z: np.ndarray
    u: np.ndarray
    y: np.ndarray
    mu: np.ndarray


def _block(
    rows: np.ndarray, columns: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns (times, m) of a block's m nonzero entries, and these (m,)."""
    i, j = values.nonzero()
    return rows[:, i], columns[:, j], values[i, j]


class BandedKKT:
    """The optimality conditions of a linear scene as a banded matrix of `size` rows."""

    def __init__(self, linear: LinearScene) -> None:
        self._linear = linear
        n, nu, nc, T = linear.n, linear.nu, linear.nc, linear.steps
        self._block = 2 * n + nu + nc
        self.size = T * self._block + n
        block = self._block * np.arange(T)[:, None]
        self._y, self.rows_u = block + np.arange(n), block + n + np.arange(nu)
        # Row t: z[t+1], mu[t+1].
        self.rows_z = block + n + nu + np.arange(n)
        self.rows_mu = block + 2 * n + nu + np.arange(nc)
        self.rows_w = T * self._block + np.arange(n)
        # Contribution of a closed contact to A.
        self._closing = np.einsum("ic,c,cj->cij", linear.E, linear.k, linear.P)
        self._settle_band()

    def _settle_band(self) -> None:
        lin, n = self._linear, self._linear.n
        q, s, r = lin.H[:n, :n], lin.H[:n, n:], lin.H[n:, n:]
        ones = np.eye(n)
        entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

        def add(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> None:
            """Add values (a, b) [-] at rows (times, a), columns (times, b) [-].

            Raises ValueError.
            """
            at_rows, at_columns, numbers = _block(rows, columns, values)
            entries.append(
                (
                    at_rows.ravel(),
                    at_columns.ravel(),
                    np.broadcast_to(numbers, at_rows.shape).ravel(),
                )
            )

        add(self._y, self.rows_z, -ones)
        add(self.rows_z, self._y, -ones)
        add(self._y, self.rows_u, lin.B)
        add(self.rows_z[:-1], self.rows_z[:-1], q)
        add(self.rows_z[:-1], self.rows_u[1:], s)
        add(self.rows_z[:-1], self.rows_mu[:-1], lin.P.T)
        # A free component of the end has no multiplier: w = 0.
        aimed = np.diag(lin.aimed.astype(float))
        add(self.rows_z[-1:], self.rows_w[None], aimed)
        add(self.rows_w[None], self.rows_z[-1:], aimed)
        add(self.rows_w[None], self.rows_w[None], ones - aimed)
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))

        pattern = (lin.A != 0) | (self._closing != 0).any(axis=0)
        self._step = np.nonzero(pattern)
        i, j = self._step
        forward = self._y[1:, i], self.rows_z[:-1, j]
        held = [
            (self.rows_u, self.rows_u, r),
            (self.rows_u, self._y, lin.B.T),
            (self.rows_u[1:], self.rows_z[:-1], s.T),
        ]
        blocks = [(_block(*block), block[2].nonzero()[0]) for block in held]
        touch = _block(self.rows_mu[:-1], self.rows_z[:-1], lin.P)
        moving = [
            forward,
            *((a, b) for (a, b, _), _ in blocks),
            (self.rows_u, self.rows_u),
            touch[:2],
            (self.rows_mu, self.rows_mu),
        ]
        distances = [rows - columns, *((a - b).ravel() for a, b in moving)]
        width = max(int(np.abs(part).max(initial=0)) for part in distances)
        self._width, self._height = width, 2 * width + 1  # as many diagonals below as above
        self._lu = BandedLU(self.size, width)
        # For the last matrix of `factor`.
        self.solve, self.product = self._lu.solve, self._lu.product
        self._constant = np.zeros((self._height, self.size), order="F")
        flat = self._constant.reshape(-1, order="F")
        np.add.at(flat, self._place(rows, columns), values)
        self._at_forward, self._at_backward = (
            self._place(*forward),
            self._place(forward[1], forward[0]),
        )
        self._at_held = [(self._place(a, b), row, numbers) for (a, b, numbers), row in blocks]
        self._at_u = self._place(self.rows_u, self.rows_u)
        self._at_touch = self._place(*touch[:2])
        self._at_mu = self._place(self.rows_mu, self.rows_mu)
        self._at_w = self._place(self.rows_w, self.rows_w)

    def _place(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return columns * self._height + self._width + rows - columns

    def factor(
        self, closed: np.ndarray, held: np.ndarray, touching: np.ndarray, *, softness: float = 0.0
    ) -> bool:
        """Factorise the KKT matrix; return False if it is singular.

        It is singular if the goal is not controllable, or if conditions contradict each other.
        - closed: (steps, nc) [-], whether a contact is closed in a step
        - held: (steps, nu) [-], whether an input is at a bound
        - touching: (steps, nc) [-], whether phi = 0 is imposed; row 0 is not used
        - softness: if positive, the cost 1/2 |z[T] - goal|^2 / softness replaces z[T] = goal

        Raises ValueError for an array of another shape.
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

    def right_side(
        self, closed: np.ndarray, held: np.ndarray, bound: np.ndarray, touching: np.ndarray
    ) -> np.ndarray:
        """Return the right-hand side (size,) [-] for conditions as in `factor`.

        bound (steps, nu) [N, N m] are the values of held inputs. Raises ValueError for another
        shape.
        """
        lin, n = self._linear, self._linear.n
        right = np.zeros(self.size)
        step = -(lin.c + (closed * (lin.k * lin.p)) @ lin.E.T)
        step[0] -= (
            lin.A + np.tensordot(closed[0].astype(float), self._closing, axes=1)
        ) @ lin.start
        slope = np.tile(-lin.g[n:], (lin.steps, 1))
        slope[0] -= lin.H[n:, :n] @ lin.start
        right[self._y], right[self.rows_u] = step, np.where(held, bound, slope)
        right[self.rows_z[:-1]] = -lin.g[:n]
        right[self.rows_mu[:-1]] = np.where(touching[1:], -lin.p, 0.0)
        right[self.rows_w] = np.where(lin.aimed, lin.goal, 0.0)
        return right

    def point(self, x: np.ndarray) -> Point:
        """Split a solution x (size,) [-]. Raises IndexError if it is too short."""
        lin = self._linear
        return Point(
            z=np.vstack([lin.start, x[self.rows_z]]),
            u=x[self.rows_u],
            y=x[self._y],
            mu=np.vstack([np.zeros((1, lin.nc)), x[self.rows_mu[:-1]]]),
        )
