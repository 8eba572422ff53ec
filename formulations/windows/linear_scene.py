"""A linear scene in numbers: z = (q, v) moves by z[t+1] = A z[t] + B u[t] + c + E lam[t], and lam_i = k_i phi_i(z) where contact i is closed.

    linear = linear_scene(scene)          # raises nothing: ask `why_not_linear(scene)` first
    linear.A @ z + linear.B @ u + linear.c + linear.E @ lam

The running cost is 1/2 x' H x + g' x + constant with x = (q, v, u). With the contact modes fixed, what is left of the planning problem
is a convex quadratic program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from models.dynamics import Dynamics, derive
from models.goal import goal_state
from models.scene import Scene

# A Hessian of the running cost counts as convex down to this part of its largest eigenvalue: rounding, and nothing more.
_CONVEX = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearScene:
    """n = 2*nq states z = (q, v). A (n, n), B (n, nu), c (n,), E (n, nc) [per N]; phi = P z + p, P (nc, n), p (nc,) [m]; k (nc,) [N/m].

    H (n+nu, n+nu), g (n+nu,), constant: the running cost; lower, upper (nu,); start, goal (n,), NaN where the end is free; step [s], steps.
    The first `contacts` of the nc rows of P are contacts. The others are bounds of velocities, phi <= 0: contacts that push with no force
    (E = 0) and are never closed.
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
        """(n,) whether a component of the end is given."""
        return ~np.isnan(self.goal)

    def with_bounds(self, closed: np.ndarray) -> np.ndarray:
        """(steps, nc) modes of contacts (steps, contacts) with those of the bounds: open."""
        return np.hstack([closed, np.zeros((len(closed), self.nc - self.contacts), dtype=bool)])

    @property
    def n(self) -> int:
        return len(self.c)

    @property
    def nu(self) -> int:
        return self.B.shape[1]

    @property
    def nc(self) -> int:
        return len(self.p)

    def penetration(self, z: np.ndarray) -> np.ndarray:
        """phi (rows, nc) [m] at states z (rows, n)."""
        return z @ self.P.T + self.p

    def cost(self, z: np.ndarray, u: np.ndarray) -> float:
        """Sum of the running cost; z (steps, n), u (steps, nu)."""
        x = np.hstack([z, u])
        return float(0.5 * ((x @ self.H) * x).sum() + (x @ self.g).sum() + self.constant * len(x))


def why_not_linear(scene: Scene) -> str | None:
    """None, or the reason why fixed contact modes do not leave a convex quadratic program."""
    dynamics = derive(scene)
    if not dynamics.structure.linear:
        return f"scene {scene.name} is not linear in q, v and u"
    if dynamics.final_cost != 0:
        return f"scene {scene.name} has a final cost"
    hessian = _cost_hessian(dynamics)
    if hessian.free_symbols:
        return f"the running cost of scene {scene.name} is not quadratic"
    eigenvalues = np.linalg.eigvalsh(np.array(hessian, dtype=float)) if hessian.rows else np.zeros(1)
    if eigenvalues[0] < -_CONVEX * max(1.0, eigenvalues[-1]):
        return f"the running cost of scene {scene.name} is not convex"
    return None


def linear_scene(scene: Scene) -> LinearScene:
    """The numbers of a scene for which `why_not_linear` is None."""
    d, task, nq = derive(scene), scene.task, scene.nq
    inverse = np.linalg.inv(_numbers(d, d.mass_matrix))
    slope = {name: inverse @ _slopes(d, d.tau, symbols) for name, symbols in (("q", d.q), ("v", d.v), ("u", d.u))}
    rest = inverse @ _at_zero(d, d.tau)
    push = inverse @ _numbers(d, d.gap_jacobian).reshape(scene.nc, nq).T
    h, eye = task.step, np.eye(nq)
    velocity = np.hstack([h * slope["q"], eye + h * slope["v"]])  # v[t+1] = velocity z + ..., q[t+1] = q + h v[t+1]
    position = np.hstack([eye, np.zeros((nq, nq))]) + h * velocity
    x = [*d.q, *d.v, *d.u]
    cost = sp.Matrix([d.running_cost])
    P, p = _velocity_bounds(scene)
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
        lower=np.array([item.lower for item in scene.inputs], dtype=float),
        upper=np.array([item.upper for item in scene.inputs], dtype=float),
        start=np.array(task.start),
        goal=goal_state(task),
        step=h,
        steps=task.steps,
        contacts=scene.nc,
    )


def _velocity_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """P (bounds, 2*nq), p (bounds,): P z + p <= 0 is the bound."""
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
    """(rows, len(symbols)) derivatives of a column of affine expressions."""
    return _numbers(d, matrix.jacobian(list(symbols))) if matrix.rows else np.zeros((0, len(symbols)))


def _at_zero(d: Dynamics, matrix: sp.Matrix) -> np.ndarray:
    """(rows,) values at q = v = u = 0."""
    return _numbers(d, matrix.subs(dict.fromkeys([*d.q, *d.v, *d.u], 0))).ravel()
