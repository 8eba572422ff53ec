"""Residuals of a plan, recomputed from the scene, unscaled, without Pyomo model or solver.

residuals = PlanResiduals(scene)
residuals.of(plan)  # of the true contact law
residuals.of(plan, law=ContactLaw.SOFTPLUS, eps=1e-3)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import sympy as sp

from formulations.grids import bound_excess
from models.catalog import as_scene
from models.codegen.kernel import load_kernel
from models.collocation import defect
from models.contact_law import ContactLaw, contact_force, sharpness
from models.dynamics import derive
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.scene.goal import distance, goal_state
from models.schemes import Scheme
from models.trajectory import Trajectory


class PlanResiduals:
    """Residual functions of one scene; the first axis of all arrays is the step."""

    def __init__(self, scene: Scene | str | Path) -> None:
        self._scene = scene = as_scene(scene)
        d = derive(scene)
        self._mass = _function(scene, d.mass_matrix, d.q)
        self._force = _function(scene, d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f))
        self._penetration = _function(scene, d.penetration, d.q)
        self._slip = _function(scene, d.slip, d.q, d.v)
        self._limit = _function(scene, d.friction_limit, d.q, d.lam)
        self._slip_nominal = np.array([friction.nominal for friction in scene.frictions])
        self._cost = _function(scene, sp.Matrix([d.running_cost]), d.q, d.v, d.u)
        self._final_cost = _function(scene, sp.Matrix([d.final_cost]), d.q, d.v)
        self._push, self._rate = (
            _function(scene, d.push, d.q, d.v),
            _function(scene, -d.gap_jacobian * sp.Matrix(d.v), d.q, d.v),
        )
        self._damping = np.array(d.damping.subs(scene.parameter_values), dtype=float).ravel()
        self._stiffness = np.array(d.stiffness.subs(scene.parameter_values), dtype=float).ravel()

    def separation(self, plan: Trajectory) -> np.ndarray:
        """Return lam - push (steps, nc) [N], where push is k phi with its damping.

        The true law requires >= 0, and 0 while a contact pushes. Raises ValueError for another
        scene's plan.
        """
        phi, damped = self._penetration(plan.q[:-1]), list(self._scene.damped)
        push = self._stiffness * phi
        if damped:
            push[:, damped] = np.where(phi > 0.0, self._push(plan.q[:-1], plan.v[:-1]), push)[
                :, damped
            ]
        return plan.lam[:, : self._scene.nc] - push

    def modes(self, plan: Trajectory) -> np.ndarray:
        """Return the contact modes of a plan, (steps, nc + 2 nf + springs + switches) [-].

        A contact is closed if its force exceeds its separation force. A friction slips forward or
        backward if the slip (in its nominal) exceeds the reserve of its force (in mu N). The
        springs and switches of damped contacts show touch. Raises ValueError for another scene's
        plan.
        """
        closed = plan.lam[:, : self._scene.nc] > np.maximum(self.separation(plan), 0.0)
        slip, force, limit = self.friction(plan)
        scale = np.maximum(limit, np.finfo(float).tiny)
        ways = [
            sign * slip / self._slip_nominal > np.maximum(1.0 + sign * force / scale, 0.0)
            for sign in (1.0, -1.0)
        ]
        scene, touches = self._scene, self._penetration(plan.q[:-1]) > 0.0
        switched = [
            index
            for index in scene.damped
            if scene.contacts[index].damping_law is DampingLaw.KELVIN_VOIGT
        ]
        springs = touches[:, [*scene.damped, *switched]]
        return np.hstack([closed, np.stack(ways, axis=2).reshape(len(closed), -1), springs])

    def friction(self, plan: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return slip at the end of a step [m/s], friction force and mu N [N], each (steps, nf).

        Raises ValueError for another scene's plan.
        """
        nc = self._scene.nc
        return (
            self._slip(plan.q[:-1], plan.v[1:]),
            plan.lam[:, nc:],
            self._limit(plan.q[:-1], plan.lam[:, :nc]),
        )

    def cost(self, plan: Trajectory) -> float:
        """Return the sum of the running cost over the steps, plus the final cost."""
        return float(
            self._cost(plan.q[:-1], plan.v[:-1], plan.u).sum()
            + self._final_cost(plan.q[-1:], plan.v[-1:]).sum()
        )

    def dynamics_defect(self, plan: Trajectory) -> float:
        """Return the largest error of the plan's time step [m, rad, m/s, rad/s].

        Collocation uses the true contact law. A plan without a scheme counts as semi-implicit
        Euler.
        """
        if plan.scheme not in (None, Scheme.SEMI_IMPLICIT_EULER):
            return float(defect(load_kernel(self._scene), plan).max())
        h = (plan.t[-1] - plan.t[0]) / plan.steps
        mass = self._mass(plan.q[:-1]).reshape(-1, self._scene.nq, self._scene.nq)
        force = self._force(plan.q[:-1], plan.v[:-1], plan.u, plan.lam)
        acceleration = np.linalg.solve(mass, force[..., None])[..., 0]
        return max(
            _largest(np.diff(plan.v, axis=0) - h * acceleration),
            _largest(np.diff(plan.q, axis=0) - h * plan.v[1:]),
        )

    def of(
        self, plan: Trajectory, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
    ) -> dict[str, float]:
        """Return the largest residuals of a plan by name, for a contact law (RELU is the true one).

        dynamics_defect : error of the time step, in velocity [m/s, rad/s] or position [m, rad]
        start_error, terminal_error : norm of x[0] - start; of x[T] - goal over the given components
        input_bound_excess : of the inputs [N, N m]
        velocity_bound_excess : of the velocities at the start of a step
        physics : sum over steps and contacts of abs(lam (lam - push)) [N^2] (paper, eq. 10)
        complementarity : largest abs(lam (lam - push)) [N^2]
        force_sign : size of a negative lam or lam - push [N]
        contact_law : error of the softplus law [N]
        friction_cone : excess of a friction force over mu N [N]
        friction_law : mu N abs(s) + f s, the shortfall from maximal dissipation [W]
        regularised_friction : error of the regularised friction law [N]
        """
        scene = self._scene
        residuals = {
            "dynamics_defect": self.dynamics_defect(plan),
            "start_error": float(np.linalg.norm(plan.start - np.array(scene.task.start))),
            "terminal_error": distance(plan.end, goal_state(scene.task)),
            **bound_excess(scene, plan),
        }
        if scene.nf:
            residuals |= self._friction_residuals(plan, law, eps)
        if not scene.nc:
            return residuals
        separation, lam = self.separation(plan), plan.lam[:, : scene.nc]
        products = np.abs(lam * separation)
        residuals["physics"] = float(products.sum())
        if law is ContactLaw.RELU:
            residuals["complementarity"] = _largest(products)
            residuals["force_sign"] = max(
                _largest(np.maximum(-lam, 0.0)), _largest(np.maximum(-separation, 0.0))
            )
        else:
            residuals["contact_law"] = _largest(lam - self._relaxed(plan, law, eps))
        return residuals

    def _relaxed(self, plan: Trajectory, law: ContactLaw, eps: float | None) -> np.ndarray:
        """Return the smoothed contact forces (steps, nc).

        Damped ones as in models/codegen/damping.h.
        """
        phi, k = self._penetration(plan.q[:-1]), self._stiffness
        lam, b = (
            contact_force(phi, k, law, eps, self._scene.length),
            sharpness(eps if eps is not None else 0.0, self._scene.length),
        )
        for i in self._scene.damped:
            share = self._damping[i] * self._rate(plan.q[:-1], plan.v[:-1])[:, i]
            if self._scene.contacts[i].damping_law is DampingLaw.KELVIN_VOIGT:
                lam[:, i] = contact_force(
                    phi[:, i] + share / k[i] * np.exp(-np.logaddexp(0.0, -b * phi[:, i])),
                    k[i],
                    law,
                    eps,
                    self._scene.length,
                )
            else:
                bl = b * self._scene.length
                lam[:, i] *= np.logaddexp(0.0, bl * (1.0 + share)) / np.logaddexp(0.0, bl)
        return lam

    def _friction_residuals(
        self, plan: Trajectory, law: ContactLaw, eps: float | None
    ) -> dict[str, float]:
        slip, force, limit = self.friction(plan)
        cone = _largest(np.maximum(np.abs(force) - limit, 0.0))
        if law is ContactLaw.RELU:
            return {
                "friction_cone": cone,
                "friction_law": _largest(limit * np.abs(slip) + force * slip),
            }
        steepness = sharpness(eps if eps is not None else 0.0) / (2.0 * self._slip_nominal)
        return {
            "friction_cone": cone,
            "regularised_friction": _largest(force + limit * np.tanh(steepness * slip)),
        }


def _function(
    scene: Scene, matrix: sp.Matrix, *groups: Sequence[sp.Symbol]
) -> Callable[..., np.ndarray]:
    return rows_of(list(matrix.subs(scene.parameter_values)), *groups)


def rows_of(entries: Sequence[sp.Expr], *groups: Sequence[sp.Symbol]) -> Callable[..., np.ndarray]:
    """Return a function of arrays (rows, size of the group) [-] with result (rows, entries)."""
    evaluate = sp.lambdify([list(group) for group in groups], list(entries), modules=[np], cse=True)

    def function(*arrays: np.ndarray) -> np.ndarray:
        """Return (rows, entries) [units of the entries] at arrays (rows, size of the group).

        Raises ValueError for a group of another size.
        """
        result = np.zeros((len(arrays[0]), len(entries)))
        for column, values in enumerate(evaluate(*(array.T for array in arrays))):
            result[:, column] = values
        return result

    return function


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
