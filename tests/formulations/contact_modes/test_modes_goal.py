"""From inputs that miss the goal to a plan: by the true rollout, by way of softplus, and by the search with a price on the miss."""

import numpy as np
import pytest

from formulations.contact_modes.goal import (
    continue_to_goal,
    correct_end,
    correct_end_by_softplus,
)
from formulations.contact_modes.linear import linear_scene
from formulations.contact_modes.quadratic import ModesProblem
from formulations.contact_modes.search import closed_steps
from models.catalog import load_scene
from models.codegen.kernel import Rollout, load_kernel
from models.scene.goal import distance

COARSE = load_scene("three_cart").with_task(steps=100, step=0.05)
KERNEL = load_kernel(COARSE)
START = np.array(COARSE.task.start)
GOAL = np.array(COARSE.task.goal, dtype=float)


def missed(rollout: Rollout) -> float:
    return distance(np.concatenate([rollout.q[-1], rollout.v[-1]]), GOAL)


def pushed(force: float) -> np.ndarray:
    u = np.zeros((100, 2))
    u[:30, 0], u[20:60, 1] = force, -0.6 * force
    return u


@pytest.mark.parametrize("force", [3.0, 4.0, 6.0])
def test_inputs_far_from_the_goal_are_corrected(force: float) -> None:
    rollout, u = correct_end(COARSE, KERNEL, pushed(force))
    again = KERNEL.rollout(START, u, COARSE.task.step)
    np.testing.assert_array_equal(again.q, rollout.q)
    assert missed(again) <= 1e-12
    assert np.abs(u).max() <= 10.0


@pytest.mark.slow
def test_without_contact_only_softplus_finds_the_way() -> None:
    """Nothing touches: the true law says nothing about the middle cart."""
    nothing = np.zeros((100, 2))
    stuck, _ = correct_end(COARSE, KERNEL, nothing)
    assert missed(stuck) > 0.1
    rollout, u = correct_end_by_softplus(COARSE, KERNEL, nothing, 7.0)
    assert missed(rollout) <= 1e-3
    assert np.abs(u).max() <= 10.0
    assert (
        continue_to_goal(ModesProblem(linear_scene(COARSE)), rollout.lam > 0, 1, lambda: False)
        is not None
    )


@pytest.mark.slow
def test_modes_that_miss_the_goal_lead_to_modes_that_meet_it() -> None:
    problem = ModesProblem(linear_scene(COARSE))
    u = pushed(1.5)
    u[30:50, 0], u[:, 1] = -1.5, 0.0
    closed = KERNEL.rollout(START, u, COARSE.task.step).lam > 0
    assert closed[:, 0].any()
    assert not closed[:, 1].any()
    assert problem.solve(closed) is None, "nothing stops the middle cart"
    answer = continue_to_goal(problem, closed, 1, lambda: False)
    assert problem.softness == 0.0
    np.testing.assert_allclose(answer.point.z[-1], GOAL, atol=1e-9)
    again = problem.solve(answer.closed)
    assert again.cost == pytest.approx(answer.cost, rel=1e-12)


def test_a_softer_goal_costs_less_and_a_hard_one_is_its_limit() -> None:
    problem = ModesProblem(linear_scene(load_scene("three_cart")))
    best = closed_steps((((131, 179),), ((276, 307),)), 500)
    hard = problem.solve(best)
    costs = []
    for softness in (1e-3, 1e-7, 1e-9):
        problem.softness = softness
        answer = problem.solve(best)
        costs.append(answer.cost)
    assert costs == sorted(costs)
    assert costs[-1] < hard.cost
    assert costs[-1] == pytest.approx(hard.cost, rel=2e-3)
    assert costs[0] < 0.9 * hard.cost


def test_the_neighbour_of_a_crowded_plan_is_solved_as_if_alone() -> None:
    """More conditions than the dual method is asked for at once: rounds from the neighbour's set give the same answer, and the same refusals."""
    scene = load_scene("three_cart").with_task(
        steps=120, step=0.02, start=(0.0, 0.53, 1.07, 0.0, 0.0, 0.0)
    )
    random = np.random.default_rng(2)
    u = 1.6 * np.repeat(random.uniform(-0.4, 1.0, (12, 2)) * np.array([1.0, -1.0]), 10, axis=0)
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    problem = ModesProblem(linear_scene(scene.with_task(goal=(*rollout.q[-1], *rollout.v[-1]))))
    near = problem.solve(rollout.lam > 0)
    assert near is not None
    compared = 0
    for shift in (-2, -1, 1, 2):
        closed = np.roll(rollout.lam > 0, shift, axis=0)
        alone, warm = problem.solve(closed), problem.solve(closed, near=near)
        assert (alone is None) == (warm is None)
        if alone is not None and warm is not None:
            compared += 1
            assert warm.cost == pytest.approx(alone.cost, rel=1e-9)
            assert problem.solve(closed, near=near, below=alone.cost * 0.999) is None
    assert compared > 0
