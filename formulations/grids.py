"""Plans on the grid of a scene's task: from a rollout, from another grid, refused.

The bounds of its inputs; and the same task on a coarser grid.

Finer steps than a task's: how far the motion departs from a plan there, with feedback, and the same
task on them.

A plan solves the equations of its grid, and a robot does not move on a grid. The motion on finer
steps is what a judge sees, in the finder's own words: the scene's own time step, driven by the
plan's inputs and by linear feedback around it. It is a start for the same task on those steps, too:
it keeps their equations and contact as they are, and misses only the goal. (Positions between two
rows, taken linearly, keep neither: `strict_lcp` then starts from nothing, and takes 1,423
iterations for push_box on steps a quarter as long instead of 110.)
"""

from __future__ import annotations

import math

import numpy as np

from models.codegen.kernel import Kernel, Rollout, load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.errors import TrajectoryError
from models.scene import Scene
from models.scene.default_limits import limit_of, replay_limits
from models.scene.goal import distance, goal_state, miss
from models.schemes import Scheme
from models.trajectory import Trajectory, input_share, uniform_grid


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
    step = np.minimum(
        (np.arange(task.steps) + 0.5) * plan.steps / task.steps, plan.steps - 1
    ).astype(int)
    states = [
        np.stack([np.interp(t, source, column) for column in array.T], axis=1)
        for array in (plan.q, plan.v)
    ]
    return Trajectory(t=t, q=states[0], v=states[1], u=plan.u[step], lam=plan.lam[step])


def check_warm_start(scene: Scene, plan: Trajectory | None) -> None:
    """Raise TrajectoryError for a plan of another scene, or on another grid than the scene's task."""
    if plan is None:
        return
    plan.check_fits(scene)
    check_grid(plan, scene.task.steps, scene.task.step, f"scene {scene.name}")


def check_grid(plan: Trajectory, steps: int, step: float, asker: str) -> None:
    """Raise TrajectoryError for a plan that does not have so many steps of this length [s], which the asker has."""
    if plan.steps != steps or not np.allclose(
        plan.t - plan.t[0], uniform_grid(step, steps), rtol=1e-9, atol=1e-9 * step
    ):
        raise TrajectoryError(
            f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but {asker} has {steps} steps of {step:g} s; "
            "resample it to that grid."
        )


def plan_of(scene: Scene, rollout: Rollout, u: np.ndarray) -> Trajectory:
    """Give the motion that the scene's own time step made of inputs u (steps, nu) [N, N m], as a plan. Raises TrajectoryError where the motion or the inputs are not finite."""
    t = uniform_grid(scene.task.step, scene.task.steps)
    return Trajectory(
        t=t, q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER
    )


def rolled_plan(
    scene: Scene,
    kernel: Kernel,
    u: np.ndarray,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> Trajectory | None:
    """Give the motion that inputs u (steps, nu) [N, N m] make from the scene's start, as a plan.

    None where it diverges. Raises KernelError for another size.
    """
    rollout = kernel.rollout(np.array(scene.task.start), u, scene.task.step, law, eps)
    return None if rollout.diverged else plan_of(scene, rollout, u)


def input_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Give the lower and upper bounds (nu,) [N, N m] of the inputs, infinite where there is none.

    Raises nothing.
    """
    return np.array([item.lower for item in scene.inputs]), np.array(
        [item.upper for item in scene.inputs]
    )


def bound_excess(scene: Scene, plan: Trajectory) -> dict[str, float]:
    """Measure by how much inputs leave their bounds [N, N m] and, where the scene bounds them, velocities at the start of a step [m/s, rad/s]."""
    pairs = [("input_bound_excess", plan.u, *input_bounds(scene))]
    if any(coordinate.has_velocity_bounds for coordinate in scene.coordinates):
        slowest, fastest = zip(
            *(
                (coordinate.velocity_lower, coordinate.velocity_upper)
                for coordinate in scene.coordinates
            ),
            strict=True,
        )
        pairs.append(("velocity_bound_excess", plan.v[:-1], np.array(slowest), np.array(fastest)))
    return {
        name: float(np.maximum(np.maximum(lower - values, values - upper), 0.0).max(initial=0.0))
        for name, values, lower, upper in pairs
    }


def replayed_goal_error(scene: Scene, kernel: Kernel, plan: Trajectory) -> float:
    """Roll the plan's inputs out through the same time step with the true contact law.

    How far from the goal that ends, in the norm of (q, v).
    """
    replay = kernel.rollout(np.array(scene.task.start), plan.u, scene.task.step)
    return distance(np.concatenate([replay.q[-1], replay.v[-1]]), goal_state(scene.task))


# Steps in one of the plan's on which it is followed: on ten feedback seems to take a tenth less
# (hopper_planar: 0.80 instead of 0.87 of the plan's inputs). Departure of a motion that leaves every
# bound.
_PARTS = 50
_LOST = 1e6


def finer_scene(scene: Scene, parts: int) -> Scene:
    """Give the same task, with the same cost, on steps of which `parts` make one of the scene's.

    Raises SceneError where the scene allows no such task.
    """
    task = scene.task
    return scene.with_task(
        steps=task.steps * parts, step=task.step / parts, running_cost=task.running_cost / parts
    )


def scene_of(scene: Scene, plan: Trajectory) -> Scene:
    """Give the task on the plan's own steps where those are finer, so many of them one of the task's; else the scene itself. Raises nothing."""
    task, parts = scene.task, plan.steps // scene.task.steps
    fits = (
        plan.steps == parts * task.steps
        and plan.has_uniform_grid
        and np.isclose(plan.duration, task.horizon, rtol=1e-9, atol=0.0)
    )
    return finer_scene(scene, parts) if parts > 1 and fits else scene


def motion_on_finer_steps(scene: Scene, plan: Trajectory, parts: int) -> Trajectory | None:
    """Give the motion that follows a plan with feedback, as a plan of `finer_scene`.

    None where it leaves every bound. Raises KernelError for a plan of another scene.
    """
    u, _ = _followed(scene, plan, parts)
    if u is None:
        return None
    finer, held = finer_scene(scene, parts), np.repeat(u, parts, axis=0)
    return plan_of(finer, load_kernel(scene).rollout(plan.start, held, finer.task.step), held)


def departure(scene: Scene, plan: Trajectory) -> float:
    """How far the motion on steps a fiftieth as long departs from a plan, with feedback: the largest part of what the scene allows.

    Returns
    -------
    float
        Of distance from the plan's positions, of distance from the goal's positions and velocities
        at the end, each over the judge's limit, and of the feedback's share of the inputs
        (`models.trajectory.input_share`) over its limit [-].

    Raises
    ------
    KernelError
        For a plan of another scene.
    """
    return _followed(scene, plan, _PARTS)[1]


@np.errstate(over="ignore", invalid="ignore")
def _followed(scene: Scene, plan: Trajectory, parts: int) -> tuple[np.ndarray | None, float]:
    """The inputs (steps, nu) with feedback [N, N m], None where the motion leaves every bound.

    And how far it departs [-].

    Feedback is the time-varying LQR with an error of the nominal size worth all of an input, held
    over a step of the plan and kept within the bounds.
    """
    lost = None, _LOST
    steps, h, x_plan = load_steps(scene), scene.task.step / parts, np.hstack([plan.q, plan.v])
    lower, upper = input_bounds(scene)
    size, half = np.tile([item.nominal for item in scene.coordinates], 2), (upper - lower) / 2.0
    half = np.where(np.isfinite(half), half, np.abs(plan.u).max(axis=0, initial=1e-9))
    after, by_x, by_u = x_plan[:-1], np.eye(len(size))[None], np.zeros((1, len(size), scene.nu))
    for _ in range(parts):
        part = steps.linearise(after, plan.u, h)
        if part is None:
            return lost
        after, by_x, by_u = part.next, part.A @ by_x, part.A @ by_u + part.B
    by_x, by_u = by_x * size / size[:, None], by_u * half / size[:, None]
    goal = goal_state(scene.task)
    value, gains = (
        np.diag(np.where(np.isnan(goal), 1.0, float(plan.steps))),
        np.empty((plan.steps, scene.nu, len(size))),
    )
    for t in reversed(range(plan.steps)):
        if not np.isfinite(value).all():
            return lost
        gains[t] = np.linalg.solve(
            np.eye(scene.nu) + by_u[t].T @ value @ by_u[t], by_u[t].T @ value @ by_x[t]
        )
        value = np.eye(len(size)) + by_x[t].T @ value @ (by_x[t] - by_u[t] @ gains[t])
    x, u, off = x_plan[0], np.empty_like(plan.u), np.zeros(scene.nq)
    for t in range(plan.steps):
        u[t] = np.clip(plan.u[t] - half * (gains[t] @ ((x - x_plan[t]) / size)), lower, upper)
        motion = steps.rollout(x, np.repeat(u[t : t + 1], parts, axis=0), h)
        if motion.diverged:
            return lost
        x, off = (
            np.concatenate([motion.q[-1], motion.v[-1]]),
            np.maximum(off, np.abs(motion.q[-1] - plan.q[t + 1])),
        )
    position, velocity = (float(np.linalg.norm(part)) for part in np.split(miss(x, goal), 2))
    share = input_share(plan.t, u - plan.u, plan.u, half)
    of = {
        "replay_terminal_position_error": position,
        "replay_terminal_velocity_error": velocity,
        "feedback_share": _LOST if share is None else share,
        "feedback_effort": float(np.sqrt(np.mean(((u - plan.u) / half) ** 2, axis=0)).max()),
    }
    departs = [float((off / replay_limits(scene)).max(initial=0.0))]
    departs += [value / limit for name, value in of.items() if (limit := limit_of(scene, name))]
    return u, min(max(departs), _LOST)
