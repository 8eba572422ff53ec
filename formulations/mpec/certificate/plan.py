"""A scene's plan as a point of the exact contact problem: certify_plan(scene, plan), whoever made the plan.

certificate = certify_plan(load_scene("three_cart"), solution.trajectory)
certificate.holds, certificate.strong, certificate.sentence

The plan is written into the strict Pyomo model of the scene - every complementarity condition as
`pyomo.mpec` states it, nothing relaxed, nothing transformed - and judged there by `certify`.
Multipliers are computed from the model's gradients, without those of the solver.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from formulations.grids import scene_of
from formulations.mpec.certificate.certificate import Certificate, Tolerances, certify
from formulations.solution import Solution
from formulations.transcription.build import build_model, load_plan
from models.catalog import as_scene
from models.scene import Scene
from models.trajectory import Trajectory

# An exact plan has 1e-13 in both (mpcc) or 1e-9 (Ipopt with fixed modes); a force that is off by
# 1e-6 N, or a contact that opens one step later, has more.
PLAN_TOLERANCES = Tolerances(feasibility=1e-8, complementarity=1e-7)


def certify_plan(scene: Scene | str | Path, plan: Trajectory) -> Certificate:
    """Judge a plan as a solution of the scene's exact problem.

    Parameters
    ----------
    scene : a scene, its name or the path of its file
    plan : on the scene's grid, or on one so many times as fine: its problem is the same task on
        that grid

    Raises
    ------
    TrajectoryError
        where the plan does not fit the scene
    SceneError, UnknownNameError
        for what is no scene
    """
    model = build_model(scene_of(as_scene(scene), plan))
    load_plan(model, plan)
    return certify(model, tolerances=PLAN_TOLERANCES)


def certify_solution(scene: Scene, solution: Solution) -> Solution:
    """Return the solution with its certificate; unchanged if it has no plan or is certified."""
    if solution.trajectory is None or solution.certificate is not None:
        return solution
    return replace(solution, certificate=certify_plan(scene, solution.trajectory))
