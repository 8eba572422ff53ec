"""How far a plan is from its equations: recomputed from the scene, unscaled, knowing neither Pyomo model nor solver.

residuals = PlanResiduals(scene)
residuals.of(plan)                                         # against the true contact law
residuals.of(plan, law=ContactLaw.SOFTPLUS, eps=1e-3)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp

from models.contact_law import ContactLaw, contact_force
from models.dynamics import derive
from models.goal import distance, goal_state
from models.scene import Scene
from models.trajectory import Trajectory


class PlanResiduals:
    """Residual functions of one scene, compiled once for numpy; all arrays have the steps as first axis."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        d = derive(scene)
        self._mass = _function(scene, d.mass_matrix, d.q)
        self._force = _function(scene, d.generalised_force, d.q, d.v, d.u, d.lam)
        self._penetration = _function(scene, d.penetration, d.q)
        self._cost = _function(scene, sp.Matrix([d.running_cost]), d.q, d.v, d.u)
        self._stiffness = np.array(d.stiffness.subs(scene.parameter_values), dtype=float).ravel()

    def separation(self, plan: Trajectory) -> np.ndarray:
        """lam - k phi (steps, nc) [N]: at least 0 under the true law, and 0 where a contact is closed."""
        return plan.lam - self._stiffness * self._penetration(plan.q[:-1])

    def modes(self, plan: Trajectory) -> np.ndarray:
        """(steps, nc) whether a contact is closed: its force is larger than its separation force."""
        return plan.lam > np.maximum(self.separation(plan), 0.0)

    def cost(self, plan: Trajectory) -> float:
        """Sum of the running cost over the steps."""
        return float(self._cost(plan.q[:-1], plan.v[:-1], plan.u).sum())

    def dynamics_defect(self, plan: Trajectory) -> float:
        """Largest miss of the semi-implicit step, in velocity or position."""
        h = (plan.t[-1] - plan.t[0]) / plan.steps
        mass = self._mass(plan.q[:-1]).reshape(-1, self._scene.nq, self._scene.nq)
        force = self._force(plan.q[:-1], plan.v[:-1], plan.u, plan.lam)
        acceleration = np.linalg.solve(mass, force[..., None])[..., 0]
        return max(_largest(np.diff(plan.v, axis=0) - h * acceleration), _largest(np.diff(plan.q, axis=0) - h * plan.v[1:]))

    def of(self, plan: Trajectory, law: ContactLaw = ContactLaw.RELU, eps: float | None = None) -> dict[str, float]:
        """Largest absolute values by name; see `MEANING`."""
        scene = self._scene
        lower, upper = np.array([item.lower for item in scene.inputs]), np.array([item.upper for item in scene.inputs])
        found = {
            "dynamics_defect": self.dynamics_defect(plan),
            "start_error": float(np.linalg.norm(plan.start - np.array(scene.task.start))),
            "terminal_error": distance(plan.end, goal_state(scene.task)),
            "input_bound_excess": _largest(np.maximum(np.maximum(lower - plan.u, plan.u - upper), 0.0)),
        }
        if any(coordinate.has_velocity_bounds for coordinate in scene.coordinates):
            slowest = np.array([coordinate.velocity_lower for coordinate in scene.coordinates])
            fastest = np.array([coordinate.velocity_upper for coordinate in scene.coordinates])
            v = plan.v[:-1]
            found["velocity_bound_excess"] = _largest(np.maximum(np.maximum(slowest - v, v - fastest), 0.0))
        if not scene.nc:
            return found
        separation = self.separation(plan)
        products = np.abs(plan.lam * separation)
        found["physics"] = float(products.sum())
        if law is ContactLaw.RELU:
            found["complementarity"] = _largest(products)
            found["force_sign"] = max(_largest(np.maximum(-plan.lam, 0.0)), _largest(np.maximum(-separation, 0.0)))
        else:
            found["contact_law"] = _largest(plan.lam - contact_force(self._penetration(plan.q[:-1]), self._stiffness, law, eps))
        return found


MEANING = {
    "dynamics_defect": "largest miss of the time step, in velocity [m/s, rad/s] or position [m, rad]",
    "start_error": "norm of x[0] - start",
    "terminal_error": "norm of x[T] - goal, over the components that are given",
    "input_bound_excess": "by how much an input leaves its bounds [N, N m]",
    "velocity_bound_excess": "by how much a velocity leaves its bounds at the start of a step",
    "physics": "sum over steps and contacts of abs(lam (lam - k phi)) [N^2] (paper, eq. 10)",
    "complementarity": "largest abs(lam (lam - k phi)) [N^2]",
    "force_sign": "by how much lam or lam - k phi is negative [N]",
    "contact_law": "largest miss of the softplus law [N]",
    "discrete_terminal_error": "norm of x[T] - goal after the plan's inputs ran through its own time step with the true contact law",
}


def _function(scene: Scene, matrix: sp.Matrix, *groups: Sequence[sp.Symbol]) -> Callable[..., np.ndarray]:
    """f(*arrays (steps, size of the group)) -> (steps, number of entries), at the scene's parameter values."""
    evaluate = sp.lambdify([list(group) for group in groups], list(matrix.subs(scene.parameter_values)), modules="numpy", cse=True)

    def function(*arrays: np.ndarray) -> np.ndarray:
        result = np.zeros((len(arrays[0]), len(matrix)))
        for column, values in enumerate(evaluate(*(array.T for array in arrays))):
            result[:, column] = values
        return result

    return function


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
