"""A bound from physics: contact forces do no work of their own, so a plan that costs little never gets much energy.

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

from dataclasses import dataclass

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.scene import Scene


@dataclass(frozen=True)
class EnergyBound:
    """Of all plans that cost at most the ceiling: speed (nq,): largest abs(v) [m/s]; penetration, approach (nc,): largest phi [m] and
    abs(dphi/dt) [m/s]."""

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
    if np.linalg.eigvalsh(0.5 * (D + D.T))[0] <= 0.0:
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
