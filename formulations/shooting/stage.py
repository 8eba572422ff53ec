"""What every shooting method does with a warm start when a stage begins, and with its plan when it ends."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from formulations.grids import check_warm_start, input_bounds
from formulations.method import Clock
from formulations.solution import Outcome, Seconds
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.trajectory import Trajectory

# Beyond a velocity bound by less [m/s, rad/s] is rounding.
_TOLERANCE = 1e-6


def first_inputs(scene: Scene, warm_start: Trajectory | None) -> np.ndarray:
    """Give the inputs (steps, nu) [N, N m] of the warm start within their bounds, or zeros. Raises TrajectoryError for a plan of another scene or grid."""
    lower, upper = input_bounds(scene)
    return np.clip(given_inputs(scene, warm_start), lower, upper)


def given_inputs(scene: Scene, warm_start: Trajectory | None) -> np.ndarray:
    """Give them as they are: (steps, nu) [N, N m]. Raises TrajectoryError for a plan of another scene or grid."""
    task = scene.task
    check_warm_start(scene, warm_start)
    return np.zeros((task.steps, scene.nu)) if warm_start is None else np.array(warm_start.u)


def plan_residuals(scene: Scene, plan: Trajectory) -> dict[str, float]:
    """Measure terminal_error, its position and velocity parts, input_bound_excess and, where the scene has such bounds, velocity_bound_excess."""
    error = miss(plan.end, goal_state(scene.task))
    lower, upper = input_bounds(scene)
    residuals = {
        "terminal_error": float(np.linalg.norm(error)),
        "terminal_position_error": float(np.linalg.norm(error[: scene.nq])),
        "terminal_velocity_error": float(np.linalg.norm(error[scene.nq :])),
        "input_bound_excess": float(np.maximum(np.maximum(lower - plan.u, plan.u - upper), 0.0).max(initial=0.0)),
    }
    if any(coordinate.has_velocity_bounds for coordinate in scene.coordinates):
        slowest = np.array([coordinate.velocity_lower for coordinate in scene.coordinates])
        fastest = np.array([coordinate.velocity_upper for coordinate in scene.coordinates])
        excess = np.maximum(slowest - plan.v[:-1], plan.v[:-1] - fastest)
        residuals["velocity_bound_excess"] = float(np.maximum(excess, 0.0).max(initial=0.0))
    return residuals


def arrived(
    scene: Scene, outcome: Outcome, message: str, residuals: Mapping[str, float], advice: str = "a larger terminal_weight"
) -> tuple[Outcome, str]:
    """Turn SOLVED into STALLED, and say why, where the plan converged away from the goal or beyond a velocity bound.

    advice: what brings it nearer to the goal.
    """
    for name in ("terminal_position_error", "terminal_velocity_error"):
        limit = scene.limit(name)
        if outcome is Outcome.SOLVED and limit is not None and limit.value is not None and residuals[name] > limit.value:
            missed = f"{name} is {residuals[name]:.3g}, the scene asks for {limit.value:g}; {advice} brings it nearer"
            outcome, message = Outcome.STALLED, f"{message} It converged away from the goal: {missed}.".strip()
    excess = residuals.get("velocity_bound_excess", 0.0)
    if outcome is Outcome.SOLVED and excess > _TOLERANCE:
        outcome, message = (
            Outcome.STALLED,
            f"{message} A velocity exceeds its bound by {excess:.3g}: this method does not know such bounds.".strip(),
        )
    goal = f" The goal is missed by {residuals['terminal_error']:.3g} in the plan's own contact model." if scene.task.has_goal else ""
    return outcome, f"{message}{goal}".strip()


def stage_seconds(stage: Clock, opening: Clock, evaluate: float, solving: float) -> Seconds:
    """Give the seconds of a stage, and of opening its session if it is the first. solving: wall seconds of the solve, of which evaluate in the scene's code."""
    stage.stop()
    (wall, cpu), (build, build_cpu) = stage.pay(), opening.pay()
    return Seconds(build=build, evaluate=evaluate, linear_algebra=max(0.0, solving - evaluate), wall=build + wall, cpu=build_cpu + cpu)
