"""What a stage really starts from: the strict program leaves a plan that misses its own time step for the first guess, and says so beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from formulations.methods import strict_lcp
from formulations.pipelines import load_method
from formulations.solution import Outcome
from formulations.transcription.solving import PlanSolver
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory, uniform_grid
from tests.formulations.transcription.rollouts import rolled_out

STEPS, STEP = 40, 0.1
SCENE = load_scene("three_cart").with_task(steps=STEPS, step=STEP)


def line(ends: float) -> Trajectory:
    """Carts that go evenly to `ends` of the way, whatever pushes them: no plan of the scene."""
    start, goal = (np.array(state, dtype=float)[: SCENE.nq] for state in (SCENE.task.start, SCENE.task.goal))
    share = np.linspace(0.0, ends, STEPS + 1)[:, None]
    q = start + share * (goal - start)
    v = np.full((STEPS + 1, SCENE.nq), 5.0)
    return Trajectory(t=uniform_grid(STEP, STEPS), q=q, v=v, u=np.zeros((STEPS, SCENE.nu)), lam=np.zeros((STEPS, SCENE.nl)))


@pytest.fixture(scope="module")
def cold():
    with load_method("strict_lcp").open(SCENE) as session:
        return session.solve(eps=None, warm_start=None, time_limit=600.0)


def test_a_broken_plan_is_no_start_and_changes_nothing(cold):
    """Bit for bit the same as cold, whichever broken plan was given."""
    with load_method("strict_lcp").open(SCENE) as session:
        assert session.start_used(None) is None
        assert session.start_used(line(1.0)) is None
        found = session.solve(eps=None, warm_start=line(1.0), time_limit=600.0)
    assert cold.trajectory is not None
    assert found.trajectory is not None
    assert (found.outcome, found.iterations, found.cost, found.message) == (cold.outcome, cold.iterations, cold.cost, cold.message)
    for name in ("q", "v", "u", "lam"):
        assert np.array_equal(getattr(found.trajectory, name), getattr(cold.trajectory, name))


def test_a_plan_that_is_one_is_started_from(cold):
    with load_method("strict_lcp").open(SCENE) as session:
        assert session.start_used(cold.trajectory) is cold.trajectory
    with load_method("softplus_dc").open(SCENE) as session:  # others start from what they are given
        broken = line(1.0)
        assert session.start_used(broken) is broken


def test_a_plan_of_another_grid_is_refused_before_it_is_looked_at(cold):
    with load_method("strict_lcp").open(SCENE) as session, pytest.raises(TrajectoryError, match="warm start"):
        session.solve(eps=None, warm_start=replace(line(1.0), t=uniform_grid(2 * STEP, STEPS)), time_limit=60.0)


@pytest.mark.slow
def test_a_plan_that_leads_nowhere_with_ipopts_own_barrier_is_tried_once_more_from_inside_its_bounds(monkeypatch):
    """A nonlinear scene's attack goes by way of looser bounds, the first of them from the plan: cut off here after so many iterations that it cannot be done."""
    scene = load_scene("acrobot_limits").with_task(steps=100, step=0.01)
    plan = rolled_out(scene, np.zeros((100, scene.nu)))
    asked: list[tuple[int, float, float]] = []

    def attempt(self, budget, options, own=PlanSolver.attempt, **named):
        begun = budget.iterations
        result = own(self, budget, options, **named)
        asked.append((options["max_iter"] - begun, options.get("bound_push", -1.0), budget.iterations - begun))
        return result

    monkeypatch.setattr(strict_lcp, "_FROM_PLAN", 3)
    monkeypatch.setattr(PlanSolver, "attempt", attempt)
    with load_method("strict_lcp").open(scene) as session:
        found = session.solve(eps=None, warm_start=plan, time_limit=600.0)
    inside = strict_lcp.StrictLCPOptions().cold_barrier()["bound_push"]
    assert found.outcome is Outcome.SOLVED, found.message
    (first, its_push, spent), (second, inside_push, _) = asked[:2]
    assert (first, spent) == (3, 3)
    assert second > 3
    assert its_push != inside_push == inside
