"""What a method hands back is looked at before anybody believes it: its type, its outcome, its shapes, and how long its plan lasts."""

from __future__ import annotations

import numpy as np
import pytest
from campaign_fakes import FakeMethod

from formulations.method import Leg, Pipeline
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory, uniform_grid
from validate.tasks.leg import planned_stages
from validate.tasks.stage import OpenLeg


def run(answer):
    (planned,) = planned_stages(Pipeline(name="p", title="p", legs=(Leg(method="m"),)), {"m": FakeMethod("m", lambda: answer)})
    with OpenLeg(load_scene("wall_pendulum"), planned) as leg:
        return leg.run(planned, None, 10.0).solution


def plan(step: float, steps: int) -> Trajectory:
    state = np.zeros((steps + 1, 1))
    return Trajectory(t=uniform_grid(step, steps), q=state, v=state, u=state[1:], lam=state[1:])


def test_a_plan_on_another_grid_of_the_same_duration_is_taken():
    task = load_scene("wall_pendulum").task
    found = run(Solution(method="m", outcome=Outcome.SOLVED, trajectory=plan(task.step / 2, 2 * task.steps)))
    assert found.trajectory.steps == 2 * task.steps


def test_a_plan_that_takes_its_time_is_refused():
    """Any damped scene comes to rest if one waits: the goal belongs to the task's end."""
    task = load_scene("wall_pendulum").task
    with pytest.raises(
        TrajectoryError, match=f"it lasts {100 * task.horizon:.6g} s, but the task of scene wall_pendulum {task.horizon:.6g} s"
    ):
        run(Solution(method="m", outcome=Outcome.SOLVED, trajectory=plan(100 * task.step, task.steps)))


def test_an_outcome_in_words_is_refused():
    with pytest.raises(TypeError, match="must be an Outcome, not str"):
        run(Solution(method="m", outcome="solved"))  # type: ignore[arg-type] - what a method of somebody else may hand back
