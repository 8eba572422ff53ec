"""A task may leave components of its end free, and bound velocities: every back end means the same by it (scene wall_pendulum)."""

from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from formulations.transcription.build import build_model
from models.catalog import load_scene
from models.errors import SceneError
from models.scene import Scene
from models.scene.goal import distance, goal_state, miss
from models.scene.parts import goal_limits
from validate.judge.score import score

SCENE = load_scene("wall_pendulum")
# Of a goal is asked how near is near enough.
ASKED = replace(SCENE, limits=(*SCENE.limits, *goal_limits(position=0.01, velocity=0.01, reason="this test")))


def bounded(lower: float, upper: float) -> Scene:
    return replace(SCENE, coordinates=(replace(SCENE.coordinates[0], velocity_lower=lower, velocity_upper=upper),))


def solved(name: str, scene: Scene) -> Solution:
    with load_method(name).open(scene) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert solution.outcome is Outcome.SOLVED, solution.message
    return solution


def both(scene: Scene) -> tuple[Solution, Solution]:
    """By the banded quadratic program of fixed modes and by Ipopt on the Pyomo model: they share no line."""
    first, second = solved("mpcc", scene), solved("strict_lcp", scene)
    assert first.cost == pytest.approx(second.cost, rel=1e-6)
    return first, second


def test_a_free_end_misses_nothing():
    goal = goal_state(SCENE.task)
    assert np.isnan(goal).all()
    assert miss(np.array([3.0, 4.0]), goal).tolist() == [0.0, 0.0]
    assert distance(np.array([3.0, 4.0]), np.array([np.nan, 1.0])) == 3.0
    assert build_model(SCENE, eps=1e-3).component("constraint_goal_position") is None
    (first, _) = both(SCENE)
    assert first.cost == pytest.approx(SCENE.answers[0].value, rel=1e-9)
    assert first.trajectory is not None
    metrics = {metric.name for metric in score(SCENE, first.trajectory, None).metrics}
    assert "velocity_bound_violation" in metrics
    assert not {name for name in metrics if "terminal" in name}


@pytest.mark.parametrize("goal", [(0.15, None), (None, 0.6), (0.15, 0.6)])
def test_a_component_of_the_end_may_be_given(goal):
    scene = ASKED.with_task(goal=goal)
    for solution in both(scene):
        assert distance(solution.trajectory.end, goal_state(scene.task)) <= 1e-8
        assert solution.cost > SCENE.answers[0].value
    given = [name for name in ("position", "velocity") if build_model(scene, eps=1e-3).component(f"constraint_goal_{name}") is not None]
    assert given == [name for name, value in zip(("position", "velocity"), goal, strict=True) if value is not None]


def test_a_given_end_may_be_a_ball():
    exact = ASKED.with_task(goal=(0.15, None))
    with load_method("mpcc").open(exact, {"goal_tolerance": 0.005}) as session:
        near = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert near.outcome is Outcome.SOLVED, near.message
    assert distance(near.trajectory.end, goal_state(exact.task)) == pytest.approx(0.005, abs=1e-9)
    assert SCENE.answers[0].value < near.cost < float(solved("mpcc", exact).cost or 0.0)


@pytest.mark.parametrize(("lower", "upper"), [(0.78, 1.5), (-1.5, 0.83)])
def test_velocity_bounds_hold_at_the_start_of_every_step(lower: float, upper: float):
    for solution in both(bounded(lower, upper)):
        v = solution.trajectory.v[:-1]
        assert v.min() >= lower - 1e-7
        assert v.max() <= upper + 1e-7
        assert min(abs(v.min() - lower), abs(v.max() - upper)) <= 1e-7, "the bound was meant to be active"
        assert solution.residuals["velocity_bound_excess"] <= 1e-7
    tight = bounded(lower, upper)
    free = solved("mpcc", SCENE).trajectory
    metric = score(tight, free, None).metric("velocity_bound_violation")
    assert metric.ok is False
    assert metric.value == pytest.approx(max(lower - free.v[:-1].min(), free.v[:-1].max() - upper))
    model = build_model(tight, eps=1e-3)
    assert (pyo.value(model.variable_v[3, "theta"].lb), pyo.value(model.variable_v[3, "theta"].ub)) == (lower, upper)
    assert model.variable_v[20, "theta"].lb is None


def test_impossible_bounds_are_refused():
    with pytest.raises(SceneError, match="velocity_lower must be below velocity_upper"):
        bounded(1.0, -1.0)
    with pytest.raises(SceneError, match=r"omega = 0\.8, outside its bounds"):
        bounded(-0.5, 0.5)
    with pytest.raises(SceneError, match=r"start\[0\]"):
        SCENE.with_task(start=(None, 0.8))
