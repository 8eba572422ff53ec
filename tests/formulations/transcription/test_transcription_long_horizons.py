"""Relaxed complementarity on a long horizon is solved on every second step before, and so on down; what it costs counts."""

import numpy as np
import pytest

from formulations.methods import relaxed_lcp
from formulations.pipelines import load_method
from formulations.solution import Outcome
from formulations.transcription.solving import PlanSolver
from models.catalog import load_scene
from tests.formulations.transcription.rollouts import rolled_out

EPS = 1e-2


def solved(scene, start):
    with load_method("relaxed_lcp").open(scene) as session:
        return session.solve(eps=EPS, warm_start=start, time_limit=120.0)


def pushed(scene):
    """A motion under a constant push: a start that is no answer."""
    return rolled_out(scene, np.full((scene.task.steps, scene.nu), 0.5))


@pytest.mark.parametrize("warm", [False, True])
def test_the_same_plan_by_way_of_coarser_grids(monkeypatch, warm):
    scene = load_scene("wall_pendulum")
    start = pushed(scene) if warm else None
    at_once = solved(scene, start)
    grids = []
    of_class = PlanSolver.attempt

    def attempt(self, budget, *arguments, **options):
        grids.append(self._scene.task.steps)
        return of_class(self, budget, *arguments, **options)

    monkeypatch.setattr(PlanSolver, "attempt", attempt)
    monkeypatch.setattr(relaxed_lcp, "_LONG", 12)
    monkeypatch.setattr(relaxed_lcp, "_SHORT", 6)
    by_grids = solved(scene, start)
    assert grids == [5, 10, 20]
    assert by_grids.outcome is at_once.outcome is Outcome.SOLVED
    assert by_grids.cost == pytest.approx(at_once.cost, rel=1e-6)
    assert by_grids.residuals["dynamics_defect"] < 1e-6
    assert by_grids.residuals["complementarity"] <= EPS + 1e-6
    # an iteration of each grid, and the starting point of each
    assert len(by_grids.history["objective"]) == by_grids.iterations + len(grids)


def test_a_grid_without_a_plan_leaves_the_start_as_it_was(monkeypatch):
    scene = load_scene("wall_pendulum")
    start = pushed(scene)
    at_once = solved(scene, start)
    monkeypatch.setattr(relaxed_lcp, "_LONG", 12)
    monkeypatch.setattr(relaxed_lcp.RelaxedLCPSession, "_from_coarser_grid", lambda *_: None)
    again = solved(scene, start)
    assert again.iterations == at_once.iterations
    np.testing.assert_array_equal(again.trajectory.u, at_once.trajectory.u)
