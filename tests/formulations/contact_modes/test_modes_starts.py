"""Where several starts come from: the mirror against a frictionless collision, the shooting solution against its own loss; a plan that touches nothing throws; and which scenes mpcc accepts is said without deriving anything."""

from dataclasses import replace
from functools import cache
from typing import cast

import numpy as np
import pytest
import sympy as sp
from example_scenes import example_scene

from formulations.contact_modes import finder
from formulations.contact_modes import session as throws
from formulations.contact_modes.quadratic import ModesProblem
from formulations.contact_modes.session import MpccSession
from formulations.contact_modes.starts import (
    descended_plan,
    final_cost,
    mirrored,
    random_plan,
    thrown_plans,
)
from formulations.method import OptionError
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.method import SolveBudget
from models import dynamics
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.goal import goal_state
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from tests.formulations.transcription.rollouts import rolled_out

SCENE = load_scene("three_cart")
SMALL = SCENE.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)
ARM = example_scene("two_link_arm")


def test_a_plan_in_the_mirror_satisfies_the_undamped_equations() -> None:
    """Backwards and mirrored, a motion without damping is a motion again: forces of the mirrored contacts accelerate the mirrored carts."""
    scene = SCENE.with_parameters(c=0.0).with_task(step=1e-4, steps=2000)
    there = rolled_out(scene.with_task(start=(2.0, 2.49, 3.0, 1.0, 0.0, 0.0)), np.zeros((2000, 2)))
    assert there.lam.max() > 0
    back = mirrored(scene, load_kernel(scene), there)
    np.testing.assert_allclose(np.gradient(back.q, 1e-4, axis=0)[5:-5], back.v[5:-5], atol=1e-2)
    kernel = load_kernel(scene)
    pushed = kernel.acceleration(back.q[:-1], back.v[:-1], back.u, back.lam)
    np.testing.assert_allclose(np.gradient(back.v, 1e-4, axis=0)[5:-6], pushed[5:-5], atol=0.05)
    assert np.abs(pushed).max() > 1.0


def test_the_mirror_takes_the_start_to_the_goal() -> None:
    task = SCENE.task
    ends = np.linspace(task.start, goal_state(task), task.steps + 1)
    plan = Trajectory(
        t=uniform_grid(task.step, task.steps),
        q=ends[:, :3],
        v=ends[:, 3:],
        u=np.ones((500, 2)),
        lam=np.ones((500, 2)),
    )
    back = mirrored(SCENE, load_kernel(SCENE), plan)
    np.testing.assert_allclose(back.start, task.start, atol=1e-12)
    np.testing.assert_allclose(back.end, goal_state(task), atol=1e-12)


def test_a_scene_that_is_not_its_own_mirror_image_has_no_mirror() -> None:
    plan = random_plan(ARM, load_kernel(ARM), (0,))
    assert plan is not None
    assert mirrored(ARM, load_kernel(ARM), plan) is None


def test_the_shooting_solution_comes_nearer_to_the_goal_at_less_than_the_best_cost() -> None:
    plan = descended_plan(SCENE, load_kernel(SCENE))
    end = np.concatenate([plan.q[-1], plan.v[-1]])
    assert np.linalg.norm(end - goal_state(SCENE.task)) < 0.3 * np.linalg.norm(
        np.array(SCENE.task.start) - goal_state(SCENE.task)
    )
    assert 0.0 < (plan.u**2).sum() < 490.0
    np.testing.assert_array_equal(plan.u, descended_plan(SCENE, load_kernel(SCENE)).u)


def several(**options) -> Solution:
    return solve_scene(SMALL, "mpcc", options=options)


@pytest.mark.slow
def test_several_starts_are_told_each_and_the_cheapest_is_kept() -> None:
    found = several(starts=6)
    assert all(start.outcome is Outcome.SOLVED for start in found.starts)
    assert len({start.start for start in found.starts}) == len(found.starts) == 6
    assert found.starts[0].start == "the paper's first guess"
    costs = [start.cost for start in found.starts if start.cost is not None]
    assert found.cost == pytest.approx(min(costs), rel=1e-9)
    assert several().starts == ()


def start_of(number: int, seed: int) -> np.ndarray:
    session = cast(MpccSession, load_method("mpcc").open(SMALL, {"seed": seed}))
    _, plan, _ = session._starts._start(SolveBudget(60.0), number, None)
    assert plan is not None
    return plan.u


def test_another_seed_is_another_random_start() -> None:
    drawn = [
        random_plan(SMALL, load_kernel(SMALL), seed) for seed in ((0, 3), (0, 3), (1, 3), (0, 4))
    ]
    inputs = [plan.u for plan in drawn if plan is not None]
    assert len(inputs) == 4
    assert np.array_equal(inputs[0], inputs[1])
    assert not any(np.isclose(inputs[0], other).any() for other in inputs[2:])
    # The sixth start is the first random one.
    first = start_of(5, seed=0)
    np.testing.assert_array_equal(first, start_of(5, seed=0))
    assert not np.isclose(first, start_of(5, seed=1)).any(), "the seed decides"
    assert not np.isclose(first, start_of(6, seed=0)).any(), "and so does the number of the start"


def test_impossible_numbers_are_refused() -> None:
    for wrong in ({"starts": 0}, {"starts": 2.5}):
        with pytest.raises(OptionError, match="start"):
            load_method("mpcc").open(SMALL, wrong)


@pytest.mark.slow
def test_random_inputs_that_led_nowhere_are_not_corrected_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They are the same whatever a start is: the second start without a plan has only its own to correct."""
    drawn: list[tuple[int, ...]] = []

    def noted(scene, kernel, seed):
        drawn.append(seed)
        return random_plan(scene, kernel, seed)

    monkeypatch.setattr(finder, "random_plan", noted)
    monkeypatch.setattr(
        ModesProblem, "solve", lambda *_given, **_named: None
    )  # no modes have a plan
    opened = load_method("mpcc").open(SMALL)
    for _ in range(2):
        assert opened.solve(eps=None, warm_start=None, time_limit=600.0).trajectory is None
        assert len(drawn) == len(set(drawn)) == 6


STEPS = 96
IDLE = 0.61


def coarse(name: str, **parameters: float) -> Scene:
    scene = load_scene(name).with_parameters(k=500.0, **parameters)
    task = scene.task
    return scene.with_task(
        steps=STEPS, step=task.horizon / STEPS, running_cost=task.running_cost * task.steps / STEPS
    )


WALL = coarse("two_discs_wall")


@cache
def solved(scene: Scene, **options: object) -> Solution:
    return solve_scene(scene, "mpcc", options={"search": False, **options}, time_limit=120.0)


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
    solution = solved(WALL, starts=2, work=2.0)
    thrown = [attempt for attempt in solution.starts if attempt.start.endswith(", then throws")]
    assert (len(solution.starts), len(thrown)) == (2, 1)
    assert thrown[0].cost == pytest.approx(solution.cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["goal", "no final cost"])
def test_where_no_throw_is_tried(change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a goal, here where disc 2 is already, or with an end that costs nothing, a plan that touches nothing is left as it is."""

    def never(*_: object) -> None:
        raise AssertionError("throws were tried")

    monkeypatch.setattr(throws, "thrown_plans", never)
    near = replace(WALL, limits=(*WALL.limits, *goal_limits(position=0.01, reason="this test")))
    scene = (
        near.with_task(goal=(None, None, -0.5, 0.6, *(None,) * 4))
        if change == "goal"
        else WALL.with_task(final_cost=0.0)
    )
    plan = solve_scene(
        scene, "mpcc", options={"search": False, "first_work": 1.0}, time_limit=120.0
    ).trajectory
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


HOPPER = load_scene("hopper")


def test_nothing_is_derived_to_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def derived(_scene: object) -> None:
        raise AssertionError("a scene was derived")

    monkeypatch.setattr(dynamics, "_build", derived)
    assert load_method("mpcc").accepts(replace(HOPPER)) is None


# Pyomo has no atan2; SymPy writes atan if the second argument is positive.
_ANGLE = sp.atan2(HOPPER.coordinates[0].symbol, HOPPER.coordinates[1].symbol - 5)


@pytest.mark.parametrize("field", ["potential_energy", "kinetic_energy"])
def test_a_function_that_pyomo_does_not_have_is_named(field: str) -> None:
    bent = replace(HOPPER, **{field: getattr(HOPPER, field) * (9 + _ANGLE)})
    reason = load_method("mpcc").accepts(bent)
    assert f"{field} contains atan2(" in reason
