"""Plans on grids: from rollouts, from other grids, and the motion on finer steps.

A judge sees the motion on finer steps: the scene's time step driven by the plan's inputs with
linear feedback. It is also a start there, because it keeps equations and contact.
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
    """Return the task over the same horizon in at most `most` steps, None if it has no more."""
    task = scene.task
    if task.steps <= most:
        return None
    steps = max(1, round(task.steps / math.ceil(task.steps / most)))
    return scene.with_task(steps=steps, step=task.horizon / steps)


def on_grid(plan: Trajectory, scene: Scene) -> Trajectory:
    """Resample a plan of the same horizon: interpolate states, hold inputs and forces."""
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
    """Raise TrajectoryError for a plan of another scene, or of another grid."""
    if plan is None:
        return
    plan.check_fits(scene)
    check_grid(plan, scene.task.steps, scene.task.step, f"scene {scene.name}")


def check_grid(plan: Trajectory, steps: int, step: float, owner: str) -> None:
    """Raise TrajectoryError unless the plan has the steps of `owner`, of this length [s]."""
    if plan.steps != steps or not np.allclose(
        plan.t - plan.t[0], uniform_grid(step, steps), rtol=1e-9, atol=1e-9 * step
    ):
        raise TrajectoryError(
            f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but {owner} has {steps} steps of {step:g} s; "
            "resample it to that grid."
        )


def plan_of(scene: Scene, rollout: Rollout, u: np.ndarray) -> Trajectory:
    """Return the rollout of inputs u (steps, nu) [N, N m] as a plan.

    Raises TrajectoryError if the motion or the inputs are not finite.
    """
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
    """Return the motion of inputs u (steps, nu) [N, N m] from the start, None if it diverges.

    Raises KernelError for another size.
    """
    rollout = kernel.rollout(np.array(scene.task.start), u, scene.task.step, law, eps)
    return None if rollout.diverged else plan_of(scene, rollout, u)


def input_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return lower (nu,) and upper (nu,) [N, N m] input bounds, infinite if missing.

    Raises nothing.
    """
    return np.array([item.lower for item in scene.inputs]), np.array(
        [item.upper for item in scene.inputs]
    )


def bound_excess(scene: Scene, plan: Trajectory) -> dict[str, float]:
    """Return the excess of inputs [N, N m] and velocities [m/s, rad/s] over their bounds."""
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
    """Return the distance of (q, v) from the goal after the plan's inputs in true contact."""
    replay = kernel.rollout(np.array(scene.task.start), plan.u, scene.task.step)
    return distance(np.concatenate([replay.q[-1], replay.v[-1]]), goal_state(scene.task))


# Steps per step of the plan for its motion; with ten, feedback appears a tenth smaller
# (hopper_planar: 0.80 instead of 0.87 of the plan's inputs).
PARTS = 50
# Departure of a motion without bounds.
LOST = 1e6


def finer_scene(scene: Scene, parts: int) -> Scene:
    """Return the task with the same cost on `parts` steps per step. Raises SceneError."""
    task = scene.task
    return scene.with_task(
        steps=task.steps * parts, step=task.step / parts, running_cost=task.running_cost / parts
    )


def scene_of(scene: Scene, plan: Trajectory) -> Scene:
    """Return the task on the plan's steps if those are an integer refinement, else the scene."""
    task, parts = scene.task, plan.steps // scene.task.steps
    fits = (
        plan.steps == parts * task.steps
        and plan.has_uniform_grid
        and np.isclose(plan.duration, task.horizon, rtol=1e-9, atol=0.0)
    )
    return finer_scene(scene, parts) if parts > 1 and fits else scene


def motion_on_finer_steps(scene: Scene, plan: Trajectory, parts: int) -> Trajectory | None:
    """Return the motion that follows a plan with feedback, as a plan of `finer_scene`.

    None without bounds. Raises KernelError for a plan of another scene.
    """
    u, _ = _followed(scene, plan, parts)
    if u is None:
        return None
    finer, held = finer_scene(scene, parts), np.repeat(u, parts, axis=0)
    return plan_of(finer, load_kernel(scene).rollout(plan.start, held, finer.task.step), held)


def departure(scene: Scene, plan: Trajectory) -> float:
    """Return how far the fine motion departs from a plan, in parts of what the scene allows.

    The result is the largest of three shares, for the motion without or with feedback, whichever
    departs less:

    - distance from the plan's positions, over the judge's limit
    - distance from the goal's positions and velocities at the end, over the judge's limit
    - the feedback's share of the inputs (`models.trajectory.input_share`) over its limit

    Raises KernelError for a plan of another scene.
    """
    driven = driven_motion(scene, plan)
    by_inputs = LOST if driven is None else distance_share(scene, plan, driven)
    return min(by_inputs, _followed(scene, plan, PARTS)[1])


def driven_motion(scene: Scene, plan: Trajectory) -> Trajectory | None:
    """Return the motion on PARTS steps per step by the plan's inputs alone, None without bounds.

    Raises KernelError for a plan of another scene.
    """
    u, finer = np.repeat(plan.u, PARTS, axis=0), finer_scene(scene, PARTS)
    motion = load_kernel(scene).rollout(plan.start, u, finer.task.step)
    return None if motion.diverged else plan_of(finer, motion, u)


def distance_share(scene: Scene, plan: Trajectory, motion: Trajectory) -> float:
    """Return the distance of a fine motion from its plan and the goal, in parts of the limits.

    motion: on PARTS steps per step of the plan. Raises nothing.
    """
    off = np.abs(motion.q[::PARTS] - plan.q).max(axis=0)
    return min(LOST, max(_shares_of_limits(scene, off, motion.end, {})))


def _shares_of_limits(
    scene: Scene, off: np.ndarray, end: np.ndarray, further: dict[str, float]
) -> list[float]:
    """Return distances from the plan (nq,) and the goal, and further metrics, over their limits."""
    missed = np.split(miss(end, goal_state(scene.task)), 2)
    of = dict(further)
    for part, values in zip(("position", "velocity"), missed, strict=True):
        of[f"replay_terminal_{part}_error"] = float(np.linalg.norm(values))
    shares = [float((off / replay_limits(scene)).max(initial=0.0))]
    return shares + [value / most for name, value in of.items() if (most := limit_of(scene, name))]


@np.errstate(over="ignore", invalid="ignore")
def _followed(scene: Scene, plan: Trajectory, parts: int) -> tuple[np.ndarray | None, float]:
    """Return the inputs (steps, nu) with feedback [N, N m], or None, and the departure [-].

    The feedback is the time-varying LQR in which a nominal error costs as much as a full input. It
    is constant over a step of the plan and respects the bounds.
    """
    lost = None, LOST
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
    share = input_share(plan.t, u - plan.u, plan.u, half)
    effort = float(np.sqrt(np.mean(((u - plan.u) / half) ** 2, axis=0)).max())
    feedback = {"feedback_share": LOST if share is None else share, "feedback_effort": effort}
    return u, min(LOST, max(_shares_of_limits(scene, off, x, feedback)))
