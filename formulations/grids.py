"""Plans on the grid of a scene's task: from a rollout, from another grid, refused; the bounds of its inputs; and the same task on a coarser grid."""

from __future__ import annotations

import math

import numpy as np

from models.codegen.kernel import Kernel, Rollout
from models.errors import TrajectoryError
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid


def coarse_scene(scene: Scene, most: int) -> Scene | None:
    """Give the scene's task over the same horizon in at most `most` steps, or None where it has no more than that."""
    task = scene.task
    if task.steps <= most:
        return None
    steps = max(1, round(task.steps / math.ceil(task.steps / most)))
    return scene.with_task(steps=steps, step=task.horizon / steps)


def on_grid(plan: Trajectory, scene: Scene) -> Trajectory:
    """Bring a plan of the same horizon to the grid of a scene: states interpolated, inputs and forces held."""
    task = scene.task
    t = uniform_grid(task.step, task.steps)
    stretch = (plan.t[-1] - plan.t[0]) / task.horizon  # 1 up to rounding
    source = (plan.t - plan.t[0]) / stretch
    step = np.minimum((np.arange(task.steps) + 0.5) * plan.steps / task.steps, plan.steps - 1).astype(int)
    states = [np.stack([np.interp(t, source, column) for column in array.T], axis=1) for array in (plan.q, plan.v)]
    return Trajectory(t=t, q=states[0], v=states[1], u=plan.u[step], lam=plan.lam[step])


def check_warm_start(scene: Scene, plan: Trajectory | None) -> None:
    """Raise TrajectoryError for a plan of another scene, or on another grid than the scene's task."""
    if plan is None:
        return
    plan.check_fits(scene)
    task = scene.task
    if plan.steps != task.steps or not np.allclose(
        plan.t - plan.t[0], uniform_grid(task.step, task.steps), rtol=1e-9, atol=1e-9 * task.step
    ):
        raise TrajectoryError(
            f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but scene {scene.name} has {task.steps} steps of "
            f"{task.step:g} s; resample it to that grid."
        )


def plan_of(scene: Scene, rollout: Rollout, u: np.ndarray) -> Trajectory:
    """Give the motion that the scene's own time step made of inputs u (steps, nu) [N, N m], as a plan. Raises TrajectoryError where the motion or the inputs are not finite."""
    t = uniform_grid(scene.task.step, scene.task.steps)
    return Trajectory(t=t, q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER)


def input_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Give the lower and upper bounds (nu,) [N, N m] of the inputs, infinite where there is none. Raises nothing."""
    return np.array([item.lower for item in scene.inputs]), np.array([item.upper for item in scene.inputs])


def bound_excess(scene: Scene, plan: Trajectory) -> dict[str, float]:
    """Measure by how much inputs leave their bounds [N, N m] and, where the scene bounds them, velocities at the start of a step [m/s, rad/s]."""
    pairs = [("input_bound_excess", plan.u, *input_bounds(scene))]
    if any(coordinate.has_velocity_bounds for coordinate in scene.coordinates):
        slowest, fastest = zip(*((coordinate.velocity_lower, coordinate.velocity_upper) for coordinate in scene.coordinates), strict=True)
        pairs.append(("velocity_bound_excess", plan.v[:-1], np.array(slowest), np.array(fastest)))
    return {
        name: float(np.maximum(np.maximum(lower - values, values - upper), 0.0).max(initial=0.0)) for name, values, lower, upper in pairs
    }


def replayed_goal_error(scene: Scene, kernel: Kernel, plan: Trajectory) -> float:
    """Roll the plan's inputs out through the same time step with the true contact law; how far from the goal that ends, in the norm of (q, v)."""
    replay = kernel.rollout(np.array(scene.task.start), plan.u, scene.task.step)
    return distance(np.concatenate([replay.q[-1], replay.v[-1]]), goal_state(scene.task))
