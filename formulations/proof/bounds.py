"""How deep and how far apart a contact can be at each step: the big-M of the mixed-integer program, valid by construction.

    bounds = pair_bounds(scene, linear, ceiling=13.63)       # of all plans that cost at most the ceiling

Three sources, each valid for every exact plan that costs at most the ceiling (infinite: for every exact plan):
1. physics (`energy_bound`), where the scene is of its form: a largest penetration, and how fast a gap can change;
2. reach, step by step: phi[t] depends on the forces before t alone, whose bounds are known by then;
3. again, with all bounds at once, as long as that decides more.
2 and 3 minimise and maximise phi[t] over the convex relaxation: two second-order cone programs a pair.

A bound from physics: contact forces do no work of their own, so a plan that costs little never gets much energy.

For M dv/dt = -C v + B u + J' lam with M, C constant and diagonal, running cost u' R u + (what is not negative), and E = 1/2 v' M v +
1/2 sum k max(phi, 0)^2, one semi-implicit step of length h obeys

    E[t+1] - E[t] <= h (w' B u - w' D w),     w = v[t+1],     D = C - h/2 (C M^-1 C + J' K J).

Proof. The elastic energy U(q) has gradient -J' lam and grows at most like its quadratic model with K everywhere closed, so
U(q + h w) - U(q) <= -h lam' J w + h^2/2 w' J' K J w. With d = w - v: 1/2 w' M w - 1/2 v' M v = w' M d - 1/2 d' M d = h w' (-C v + B u + J' lam)
- 1/2 d' M d, and -h w' C v = -h w' C w + h w' C d <= -h w' C w + 1/2 d' M d + h^2/2 w' C M^-1 C w. The terms of lam and d cancel. []

Where D is positive definite, w' B u - w' D w <= 1/4 u' B' D^-1 B u <= g u' R u with g the largest eigenvalue of 1/4 R^-1/2 B' D^-1 B R^-1/2, hence

    E[t] <= E[0] + h g (cost).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sympy as sp

from formulations.contact_modes.linear import LinearScene
from formulations.proof.relaxation import Relaxation
from models.dynamics import derive
from models.scene import Scene


@dataclass(frozen=True)
class EnergyBound:
    """Bounds of all plans that cost at most the ceiling.

    speed (nq,): largest abs(v) [m/s]; penetration, approach (nc,): largest phi [m] and abs(dphi/dt) [m/s]
    """

    speed: np.ndarray
    penetration: np.ndarray
    approach: np.ndarray


def energy_bound(scene: Scene, ceiling: float) -> EnergyBound | None:
    """The bound, or None where the scene is not of the form above."""
    d, task, nq = derive(scene), scene.task, scene.nq
    values = scene.parameter_values
    tau, states = d.tau.subs(values), [*d.q, *d.v]
    if not d.structure.linear or not d.structure.diagonal_mass or tau.jacobian(d.q) != sp.zeros(nq, nq) or not scene.nu:
        return None
    drag, inputs = -tau.jacobian(d.v), tau.jacobian(d.u)
    if not drag.is_diagonal() or any(entry != 0 for entry in tau.subs(dict.fromkeys([*states, *d.u], 0))):
        return None
    cost = sp.expand(d.running_cost.subs(values))
    if cost.free_symbols & set(states) or sp.expand(d.final_cost) != 0:
        return None
    weight = np.array(sp.hessian(cost, list(d.u)), dtype=float) / 2.0
    rest = cost - (sp.Matrix([list(d.u)]) * sp.Matrix(weight) * sp.Matrix(list(d.u)))[0]
    if sp.expand(rest) != 0 or np.linalg.eigvalsh(weight)[0] <= 0.0:
        return None
    M, C, B = (np.array(matrix, dtype=float) for matrix in (d.mass_matrix.subs(values), drag, inputs))
    J, k = np.array(d.gap_jacobian.subs(values), dtype=float).reshape(scene.nc, nq), np.array(d.stiffness.subs(values), dtype=float).ravel()
    D = C - 0.5 * task.step * (C @ np.linalg.inv(M) @ C + J.T @ np.diag(k) @ J)
    if np.linalg.eigvalsh(D)[0] <= 0.0:
        return None
    root = np.linalg.inv(np.linalg.cholesky(weight))
    gain = float(np.linalg.eigvalsh(0.25 * root @ B.T @ np.linalg.inv(D) @ B @ root.T)[-1])
    v = np.array(task.start[nq:])
    phi = np.array(d.penetration.subs(values).subs(dict(zip(d.q, task.start[:nq], strict=True))), dtype=float).ravel()
    energy = 0.5 * float(v @ M @ v) + 0.5 * float(k @ np.maximum(phi, 0.0) ** 2) + task.step * gain * ceiling
    inverse = np.linalg.inv(M)
    return EnergyBound(
        speed=np.sqrt(2.0 * energy * np.diag(inverse)),
        penetration=np.sqrt(2.0 * energy / k),
        approach=np.sqrt(2.0 * energy * np.einsum("ci,ij,cj->c", J, inverse, J)),
    )


_ROUNDS = 3  # of source 3 at most; three carts: the second round moves bounds by less than a hundredth of their width
_WORTH = 0.9  # a round is followed by another if it leaves less than this part of the summed widths


@dataclass(frozen=True, kw_only=True, eq=False)
class PairBounds:
    """lower, upper (steps, nc): of phi [m], for all exact plans that cost at most `ceiling`; row 0 is the start. is_empty: there are none."""

    lower: np.ndarray
    upper: np.ndarray
    ceiling: float
    is_empty: bool = False

    @property
    def decided(self) -> np.ndarray:
        """Mask (steps, nc) of pairs that can only be open, or only be closed [-]."""
        return (self.upper <= 0.0) | (self.lower >= 0.0)

    @property
    def is_finite(self) -> bool:
        """Whether each pair has a bound on both sides."""
        return bool(np.isfinite(self.lower).all() and np.isfinite(self.upper).all())


def physical_bounds(scene: Scene, linear: LinearScene, ceiling: float) -> PairBounds:
    """Source 1 alone; infinite where the scene is not of the form of `energy_bound`."""
    T, nc = linear.steps, linear.contacts
    lower, upper = np.full((T, nc), -np.inf), np.full((T, nc), np.inf)
    start = linear.penetration(linear.start[None])[0, :nc]
    found = energy_bound(scene, ceiling) if np.isfinite(ceiling) else None
    if found is not None:
        time = linear.step * np.arange(T)[:, None]
        lower, upper = start - found.approach * time, np.minimum(found.penetration, start + found.approach * time)
        if linear.aimed[: scene.nq].all():
            end = linear.penetration(np.nan_to_num(linear.goal)[None])[0, :nc]  # of places alone: velocities may be free
            left = linear.step * (T - np.arange(T))[:, None]
            lower, upper = np.maximum(lower, end - found.approach * left), np.minimum(upper, end + found.approach * left)
    lower[0] = upper[0] = start
    return PairBounds(lower=lower, upper=upper, ceiling=ceiling)


def pair_bounds(scene: Scene, linear: LinearScene, ceiling: float = np.inf, *, is_over: Callable[[], bool] = lambda: False) -> PairBounds:
    """Bounds of every pair, from all three sources of the module docstring.

    Parameters
    ----------
    scene, linear : the scene, and its linear form
    ceiling : the most that plans may cost
    is_over : whether to stop; bounds not reached by then are those of physics, or infinite
    """
    relaxation = Relaxation(linear)
    bounds = physical_bounds(scene, linear, ceiling)
    width = np.inf
    for _ in range(1 + _ROUNDS):
        bounds = _swept(relaxation, bounds, is_over)
        if bounds.is_empty or is_over() or not bounds.is_finite:
            break
        before, width = width, float((bounds.upper - bounds.lower)[~bounds.decided].sum())
        if width > _WORTH * before or width == 0.0:
            break
    return bounds


def _swept(relaxation: Relaxation, bounds: PairBounds, is_over: Callable[[], bool]) -> PairBounds:
    """Every pair once, in the order of time, each with the bounds found before it."""
    lower, upper = bounds.lower.copy(), bounds.upper.copy()
    for t in range(1, len(lower)):
        for contact in range(lower.shape[1]):
            for sign, side in ((1.0, lower), (-1.0, upper)):
                if is_over():
                    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling)
                found = relaxation.least_penetration(t, contact, sign, lower, upper, bounds.ceiling)
                if found.status == "unfinished" and np.isinf(side[t, contact]):  # the ceiling makes the program harder; any bound will do
                    found = relaxation.least_penetration(t, contact, sign, lower, upper, np.inf)
                if found.status == "infeasible":
                    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling, is_empty=True)
                side[t, contact] = sign * max(sign * side[t, contact], found.bound)  # unfinished: -inf, which is no better
    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling)
