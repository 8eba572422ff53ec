"""Certify a scene's plan as a point of the exact contact problem.

    certificate = certify_plan(load_scene("three_cart"), solution.trajectory)
    certificate.holds, certificate.strong, certificate.sentence

The plan's values are set in the scene's strict Pyomo model, without any relaxation. Multipliers
come from the model's gradients.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from formulations.certificate.certificate import Certificate, Tolerances, certify
from formulations.grids import scene_of
from formulations.solution import Solution
from formulations.transcription.build import build_model, load_plan
from models.catalog import as_scene
from models.scene import Scene
from models.trajectory import Trajectory

# Exact plans have 1e-13 (mpcc) or 1e-9 (Ipopt with fixed modes) in both. A force error of 1e-6 N,
# or a contact that opens one step later, exceeds them.
PLAN_TOLERANCES = Tolerances(feasibility=1e-8, complementarity=1e-7)


def certify_plan(scene: Scene | str | Path, plan: Trajectory) -> Certificate:
    """Certify a plan as a solution of the scene's exact problem.

    Parameters
    ----------
    scene : a scene, its name or the path of its file
    plan : on the scene's grid, or on an integer refinement of the grid

    Raises
    ------
    TrajectoryError
        if the plan does not fit the scene
    SceneError, UnknownNameError
        if there is no such scene
    """
    model = build_model(scene_of(as_scene(scene), plan))
    load_plan(model, plan)
    return certify(model, tolerances=PLAN_TOLERANCES)


def certify_solution(scene: Scene, solution: Solution) -> Solution:
    """Return the solution with its certificate, if it has a plan and no certificate."""
    if solution.trajectory is None or solution.certificate is not None:
        return solution
    return replace(solution, certificate=certify_plan(scene, solution.trajectory))
