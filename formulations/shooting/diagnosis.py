"""Why a descent ends where it ends, in numbers and then in words.

The rows of S = d x_T / d u, one adjoint each, tell what the inputs can still do: a coordinate whose row is zero stays where it
is, whatever its error. With a dead ReLU that is every body that only contact moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from formulations.shooting.objective import Objective
from models.contact_law import ContactLaw
from models.scene import Scene

# A coordinate counts as missed beyond this share of its nominal size, and as out of reach if one iteration closes less than
# this share of its error through its own row of S (a million iterations would not get there).
_MISSED = 1e-4
_OUT_OF_REACH = 1e-6

# Enough for one digit of the largest curvature; the difference is small against the inputs and large against rounding.
_POWER_ITERATIONS = 20
_DIFFERENCE = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Derivatives of the last state: to_inputs (2*nq, steps*nu), to_start (2*nq, 2*nq)."""

    to_inputs: np.ndarray
    to_start: np.ndarray

    @property
    def growth(self) -> float:
        """Largest factor by which a disturbance of the start grows over the horizon."""
        return float(np.linalg.norm(self.to_start, 2))


def sensitivity(objective: Objective, u: np.ndarray) -> Sensitivity:
    """Differentiate the last state at inputs u (steps, nu) [N, N m], by one adjoint sweep for each of its components.

    Raises KernelError where the mass matrix is not positive definite along the rollout.
    """
    kernel, task = objective.kernel, objective.kernel.scene.task
    plan = kernel.rollout(np.array(task.start), u, task.step, objective.law, objective.eps)
    rows = [kernel.adjoint(plan, u, end_bar=component) for component in np.eye(2 * kernel.scene.nq)]
    return Sensitivity(to_inputs=np.array([u_bar.ravel() for u_bar, _ in rows]), to_start=np.array([start_bar for _, start_bar in rows]))


def out_of_reach(objective: Objective, rows: Sensitivity, learning_rate: float) -> list[str]:
    """Name the coordinates that miss the goal and that no gradient moves, each with its error."""
    scene, missed = objective.kernel.scene, np.abs(objective.error)
    found = []
    for index, coordinate in enumerate(scene.coordinates):
        closes = learning_rate * objective.weights.terminal / len(missed) * 2.0 * float(rows.to_inputs[index] @ rows.to_inputs[index])
        if missed[index] > _MISSED * coordinate.nominal and closes < _OUT_OF_REACH:
            slope = float(np.linalg.norm(rows.to_inputs[index]))
            found.append(
                f"{coordinate.name} (it misses its goal by {missed[index]:.3g} {coordinate.unit}; |d {coordinate.name}/d u| = {slope:.2g})"
            )
    return found


def dead_contact_message(objective: Objective, rows: Sensitivity, learning_rate: float) -> str:
    """Say which coordinate misses the goal although nothing moves it; "" where there is none."""
    found = out_of_reach(objective, rows, learning_rate)
    if not found:
        return ""
    names = " and ".join(found)
    assert objective.plan is not None
    scene, relu, step = objective.kernel.scene, objective.law is ContactLaw.RELU, objective.kernel.scene.task.step
    consequence = f"so the loss has no gradient towards moving {names}"
    if not scene.nc:
        return f"no input reaches it, {consequence}."
    phi = objective.kernel.penetration(objective.plan.q.detach().numpy()[:-1])
    if relu:
        never = [index for index in range(scene.nc) if phi[:, index].max() <= 0.0]
        if len(never) == scene.nc:
            what = f"no contact is made anywhere on the trajectory ({_gaps(scene, phi, never, step)})"
        elif never:
            what = f"contact {' and '.join(scene.contacts[index].name for index in never)} is never made ({_gaps(scene, phi, never, step)})"
        else:
            what = "every contact is made, but none carries an input's effect to the end"
        return f"{what}, {consequence}; start from a softplus stage."
    force = objective.plan.lam.max().item()
    everywhere = list(range(scene.nc))
    return f"the relaxed contact is too faint (largest force {force:.2g} N; {_gaps(scene, phi, everywhere, step)}), {consequence}; start from a larger eps."


def _gaps(scene: Scene, phi: np.ndarray, contacts: list[int], step: float) -> str:
    closest = [(scene.contacts[index].name, int(phi[:, index].argmax()), -float(phi[:, index].max())) for index in contacts]
    return "smallest gap " + ", ".join(f"{name} {gap:.3g} m at t = {node * step:.3g} s" for name, node, gap in closest)


def stable_rate(objective: Objective, u: np.ndarray) -> float:
    """Give the largest learning rate at which a gradient step near u (steps, nu) [N, N m] does not overshoot: 2 / largest curvature of the loss.

    The curvature comes from a power iteration on differences of gradients, so that all of the loss counts: the way to the goal,
    contacts, and the running cost.

    Raises KernelError where the mass matrix is not positive definite along the rollout.
    """
    objective.value(u)
    direction = objective.gradient().copy()
    curvature = 0.0
    for _ in range(_POWER_ITERATIONS):
        norm = float(np.linalg.norm(direction))
        if not (np.isfinite(norm) and norm > 0.0):
            break
        direction *= _DIFFERENCE * max(1.0, float(np.linalg.norm(u))) / norm
        length = float(np.linalg.norm(direction))
        gradients = []
        for sign in (1.0, -1.0):
            if not np.isfinite(objective.value(u + sign * direction)):
                return np.nan
            gradients.append(objective.gradient().copy())
        direction = gradients[0] - gradients[1]
        curvature = float(np.linalg.norm(direction)) / (2.0 * length)
    return 2.0 / curvature if curvature > 0.0 else np.inf


def divergence_message(objective: Objective, learning_rate: float, iteration: int, best: np.ndarray | None) -> str:
    """Say what went wrong at this iteration, with growth and rate at the best inputs seen (steps, nu) [N, N m], if there are any. Raises KernelError where the mass matrix is not positive definite along the rollout."""
    where = (
        f"after {iteration} {'iteration' if iteration == 1 else 'iterations'} at learning rate {learning_rate:g}"
        if iteration
        else "at the first guess"
    )
    if objective.finite:
        what = f"{where} the loss climbs instead of descending"
    else:
        steps = objective.finite_steps
        what = f"{where} the rollout is no longer finite beyond step {steps} (t = {steps * objective.kernel.scene.task.step:.3g} s)"
    if best is None:
        return f"{what}; start, parameters and inputs must allow a simulation to the end of the horizon."
    rate, growth = stable_rate(objective, best), sensitivity(objective, best).growth
    advice = f"; a learning rate below {_rounded_down(rate)} would not overshoot there" if np.isfinite(rate) else ""
    return f"{what}; at the best plan a disturbance of the start grows by a factor of {growth:.3g} over the horizon{advice}."


def _rounded_down(value: float) -> str:
    """One digit, so that the text promises no more than an estimate can."""
    scale = 10.0 ** math.floor(math.log10(value))
    return f"{math.floor(value / scale) * scale:g}"
