"""A free end with a cost, and a plan that touches nothing: mpcc throws. On a coarse grid in soft contact; doing nothing costs 0.61 there too."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from formulations.contact_modes import session as throws
from formulations.contact_modes.starts import final_cost, thrown_plans
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.parts import goal_limits

STEPS = 96
IDLE = 0.61


def coarse(name: str, **parameters: float) -> Scene:
    scene = load_scene(name).with_parameters(k=500.0, **parameters)
    task = scene.task
    return scene.with_task(steps=STEPS, step=task.horizon / STEPS, running_cost=task.running_cost * task.steps / STEPS)


WALL = coarse("two_discs_wall")


@cache
def solved(scene: Scene, **options: object) -> Solution:
    with load_method("mpcc").open(scene, {"search": False, **options}) as session:
        return session.solve(eps=None, warm_start=None, time_limit=120.0)


@pytest.mark.slow
def test_without_throws_nothing_is_done() -> None:
    solution = solved(WALL, throw_work=0.0)
    assert solution.cost == pytest.approx(IDLE, rel=1e-6)
    assert not solution.trajectory.lam.any()


@pytest.mark.slow
def test_a_plan_that_touches_nothing_is_begun_again_from_throws() -> None:
    solution = solved(WALL)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.cost < 0.9 * IDLE
    plan, task = solution.trajectory, WALL.task
    kernel = load_kernel(WALL)
    rollout = kernel.rollout(np.array(task.start), plan.u, task.step)
    np.testing.assert_array_equal(plan.lam, rollout.lam)
    assert plan.lam[:, 0].any()  # disc 1 hits disc 2 ..
    assert plan.lam[:, 2].any()  # .. which comes back from the wall
    assert kernel.cost(rollout.q, rollout.v, plan.u) == pytest.approx(solution.cost, rel=1e-9)
    assert "from throws" in solution.message


@pytest.mark.slow
def test_of_several_starts_the_cheapest_is_replaced() -> None:
    solution = solved(WALL, starts=2, first_start=5, work=2.0)
    thrown = [attempt for attempt in solution.starts if attempt.start.endswith(", then throws")]
    assert [attempt.number for attempt in solution.starts] == [5, 6]
    assert len(thrown) == 1
    assert thrown[0].cost == pytest.approx(solution.cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["goal", "no final cost"])
def test_where_no_throw_is_tried(change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a goal, here where disc 2 is already, or with an end that costs nothing, a plan that touches nothing is left as it is."""

    def never(*_: object) -> None:
        raise AssertionError("throws were tried")

    monkeypatch.setattr(throws, "thrown_plans", never)
    near = replace(WALL, limits=(*WALL.limits, *goal_limits(position=0.01, reason="this test")))
    scene = near.with_task(goal=(None, None, -0.5, 0.6, *(None,) * 4)) if change == "goal" else WALL.with_task(final_cost=0.0)
    with load_method("mpcc").open(scene, {"search": False, "first_work": 1.0}) as session:
        plan = session.solve(eps=None, warm_start=None, time_limit=120.0).trajectory
    assert plan is None or not plan.lam.any()


@pytest.mark.slow
def test_throws_press_what_was_not_pressed_and_end_nearer() -> None:
    kernel, idle = load_kernel(WALL), np.zeros(3, dtype=bool)
    plans = thrown_plans(WALL, kernel, (0, 0), idle, IDLE)
    assert plans
    costs = [kernel.cost(plan.q, plan.v, plan.u) for plan in plans]
    assert costs == sorted(costs)
    for plan in plans:
        rollout = kernel.rollout(np.array(WALL.task.start), plan.u, WALL.task.step)
        assert plan.lam.any()
        assert final_cost(kernel, rollout) == pytest.approx((plan.q[-1, 2:4] ** 2).sum(), rel=1e-12)
        assert final_cost(kernel, rollout) < IDLE
    assert not thrown_plans(WALL, kernel, (0, 0), ~idle, IDLE)
    assert not thrown_plans(WALL, kernel, (0, 0), idle, 0.0)
    again = thrown_plans(WALL, kernel, (0, 0), idle, IDLE)
    np.testing.assert_array_equal(again[0].u, plans[0].u)
    assert not np.array_equal(thrown_plans(WALL, kernel, (0, 5), idle, IDLE)[0].u, plans[0].u)
