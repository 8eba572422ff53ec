"""What a method hands back is looked at before anybody believes it: its type, its outcome, its shapes, and how long its plan lasts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from campaign_fakes import FakeMethod

from formulations.method import Leg, Pipeline
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory, uniform_grid
from validate.tasks import stage as module
from validate.tasks.leg import planned_stages
from validate.tasks.stage import OpenLeg


def planned_one(answer):
    (planned,) = planned_stages(Pipeline(name="p", title="p", legs=(Leg(method="m"),)), {"m": FakeMethod("m", lambda: answer)})
    return planned


def run(answer):
    planned = planned_one(answer)
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


def test_the_first_stage_pays_for_the_opening_and_no_other_does(monkeypatch: pytest.MonkeyPatch):
    """With clocks that go on by 1 s and by 8 s whenever they are looked at: a stage takes one look, and so do opening and asking before it."""
    walls, cpus = itertools.count(5.0, 1.0), itertools.count(70.0, 8.0)
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(walls))
    monkeypatch.setattr(module.time, "process_time", lambda: next(cpus))
    planned = planned_one(Solution(method="m", outcome=Outcome.SOLVED))
    with OpenLeg(load_scene("wall_pendulum"), planned) as leg:
        leg.leaves(None)
        first, second, third = (leg.run(planned, None, 10.0) for _ in range(3))
    assert [(stage.wall, stage.cpu) for stage in (first, second, third)] == [(3.0, 24.0), (1.0, 8.0), (1.0, 8.0)]
