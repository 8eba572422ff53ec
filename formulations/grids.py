"""Plans on the grid of a scene's task: from a rollout, from another grid, refused; the bounds of its inputs; and the same task on a coarser grid."""

from __future__ import annotations

import math

import numpy as np

from models.codegen.kernel import Rollout
from models.errors import TrajectoryError
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid


def coarse_scene(scene: Scene, most: int) -> Scene | None:
    """The scene's task over the same horizon in at most `most` steps, or None where it has no more than that."""
    task = scene.task
    if task.steps <= most:
        return None
    steps = max(1, round(task.steps / math.ceil(task.steps / most)))
    return scene.with_task(steps=steps, step=task.horizon / steps)


def on_grid(plan: Trajectory, scene: Scene) -> Trajectory:
    """A plan of the same horizon on the grid of a scene: states interpolated, inputs and forces held."""
    task = scene.task
    t = uniform_grid(task.step, task.steps)
    stretch = (plan.t[-1] - plan.t[0]) / task.horizon  # 1 up to rounding
    source = (plan.t - plan.t[0]) / stretch
    step = np.minimum((np.arange(task.steps) + 0.5) * plan.steps / task.steps, plan.steps - 1).astype(int)
    states = [np.stack([np.interp(t, source, column) for column in array.T], axis=1) for array in (plan.q, plan.v)]
    return Trajectory(t=t, q=states[0], v=states[1], u=plan.u[step], lam=plan.lam[step])


def check_warm_start(scene: Scene, plan: Trajectory) -> None:
    """Raises TrajectoryError for a plan of another scene, or on another grid than the scene's task."""
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
    """The motion that the scene's own time step made of inputs u (steps, nu), as a plan."""
    t = uniform_grid(scene.task.step, scene.task.steps)
    return Trajectory(t=t, q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER)


def input_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (nu,) of the inputs, infinite where there is none."""
    return np.array([item.lower for item in scene.inputs]), np.array([item.upper for item in scene.inputs])
