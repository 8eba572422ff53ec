"""A scene's plan as a point of the exact contact problem: certify_plan(scene, plan), whoever made the plan.

certificate = certify_plan(load_scene("three_cart"), solution.trajectory)
certificate.holds, certificate.stationarity.letter, certificate.sentence

The plan is written into the strict Pyomo model of the scene - every complementarity condition as
`pyomo.mpec` states it, nothing relaxed, nothing transformed - and judged there by `certify`.
Multipliers are computed anew from the model's gradients: those of the solver are not asked.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from formulations.grids import scene_of
from formulations.mpec.certificate.certificate import Certificate, Tolerances, certify
from formulations.solution import Solution
from formulations.transcription.build import build_model, load_plan, move_ball, open_goal
from models.catalog import as_scene
from models.scene import Scene
from models.trajectory import Trajectory

# An exact plan has 1e-13 in both (mpcc) or 1e-9 (Ipopt with fixed modes); a force that is off by
# 1e-6 N, or a contact that opens one step later, has more.
PLAN_TOLERANCES = Tolerances(feasibility=1e-8, complementarity=1e-7)


class PlanJudge:
    """Judges plans of one scene.

    Its strict model is built once for a goal that is a point, once for one that is a ball, and for
    each grid.
    """

    def __init__(self, scene: Scene | str | Path) -> None:
        self._scene = as_scene(scene)
        self._models: dict[tuple[bool, int], Any] = {}

    def certify(self, plan: Trajectory, *, goal_tolerance: float) -> Certificate:
        """Judge one plan, as `certify_plan`."""
        kind, scene = (goal_tolerance > 0.0, plan.steps), scene_of(self._scene, plan)
        if kind not in self._models:
            self._models[kind] = build_model(scene)
            open_goal(self._models[kind], goal_tolerance)
        model = self._models[kind]
        move_ball(model, goal_tolerance)
        load_plan(model, plan)
        return certify(model, tolerances=PLAN_TOLERANCES)


def certify_plan(
    scene: Scene | str | Path, plan: Trajectory, *, goal_tolerance: float = 0.0
) -> Certificate:
    """Judge a plan as a solution of the scene's exact problem.

    Parameters
    ----------
    scene : a scene, its name or the path of its file
    plan : on the scene's grid, or on one so many times as fine: its problem is the same task on
        that grid
    goal_tolerance : norm of (q, v)[T] - goal within which the plan may end; then the problem is the
        one with that ball for a goal

    Raises
    ------
    TrajectoryError
        where the plan does not fit the scene
    SceneError, UnknownNameError
        for what is no scene
    """
    return PlanJudge(scene).certify(plan, goal_tolerance=goal_tolerance)


def certify_solution(scene: Scene, solution: Solution) -> Solution:
    """The same solution with its certificate, and those of its front.

    Unchanged if it has no plan, or has its certificate already.

    A ball around the goal is read off its options.
    """
    return _certified(PlanJudge(scene), solution)


def _certified(judge: PlanJudge, solution: Solution) -> Solution:
    points = tuple(
        replace(point, solution=_certified(judge, point.solution)) for point in solution.front
    )
    if solution.trajectory is None:
        return replace(solution, front=points)
    if points:  # its plan is that of the smallest tolerance
        return replace(solution, certificate=points[0].solution.certificate, front=points)
    if solution.certificate is not None:
        return solution
    ball = float(cast(float, solution.options.get("goal_tolerance", 0.0)))
    return replace(solution, certificate=judge.certify(solution.trajectory, goal_tolerance=ball))
