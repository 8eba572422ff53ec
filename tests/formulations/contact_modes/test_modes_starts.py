"""Where several starts come from: the mirror against a frictionless collision, the shooting solution against its own loss, numbers against a split."""

import numpy as np
import pytest
from example_scenes import example_scene

from formulations.contact_modes import finder
from formulations.contact_modes.quadratic import ModesProblem
from formulations.contact_modes.starts import descended_plan, mirrored, random_plan
from formulations.method import OptionError
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene.goal import goal_state
from models.trajectory import Trajectory, uniform_grid
from tests.formulations.transcription.rollouts import rolled_out

SCENE = load_scene("three_cart")
SMALL = SCENE.with_task(start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100)
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
    plan = Trajectory(t=uniform_grid(task.step, task.steps), q=ends[:, :3], v=ends[:, 3:], u=np.ones((500, 2)), lam=np.ones((500, 2)))
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
    assert np.linalg.norm(end - goal_state(SCENE.task)) < 0.3 * np.linalg.norm(np.array(SCENE.task.start) - goal_state(SCENE.task))
    assert 0.0 < (plan.u**2).sum() < 490.0
    np.testing.assert_array_equal(plan.u, descended_plan(SCENE, load_kernel(SCENE)).u)


def several(**options) -> Solution:
    with load_method("mpcc").open(SMALL, options) as session:
        return session.solve(eps=None, warm_start=None, time_limit=600.0)


@pytest.mark.slow
def test_starts_run_apart_are_those_run_together() -> None:
    together, apart = several(starts=6), [several(starts=3, first_start=first) for first in (0, 3)]
    assert [start.number for start in together.starts] == list(range(6))
    assert [(start.number, start.start, start.cost, start.windows) for start in together.starts] == [
        (start.number, start.start, start.cost, start.windows) for part in apart for start in part.starts
    ]
    assert together.cost == min(part.cost for part in apart if part.cost is not None)
    assert all(start.outcome is Outcome.SOLVED for start in together.starts)
    assert len({start.start for start in together.starts}) == 6
    assert together.starts[0].start == "the paper's first guess"
    assert several().starts == ()


@pytest.mark.slow
def test_another_seed_is_another_random_start() -> None:
    drawn = [random_plan(SMALL, load_kernel(SMALL), seed) for seed in ((0, 3), (0, 3), (1, 3), (0, 4))]
    inputs = [plan.u for plan in drawn if plan is not None]
    assert len(inputs) == 4
    assert np.array_equal(inputs[0], inputs[1])
    assert not any(np.isclose(inputs[0], other).any() for other in inputs[2:])
    # The same best plan, by other ways: the sixth start is the first random one.
    ways = [several(starts=1, first_start=first, seed=seed).iterations for first, seed in ((5, 0), (5, 0), (5, 1), (5, 2), (6, 0), (7, 0))]
    assert ways[0] == ways[1]
    assert len(set(ways[1:4])) > 1, "the seed decides"
    assert len({ways[0], *ways[4:]}) > 1, "and so does the number of the start"


def test_contacts_of_a_start_are_named_by_contact() -> None:
    solution = several(starts=2)
    plan = solution.trajectory
    best = min(solution.starts, key=lambda start: float("inf") if start.cost is None else start.cost)
    closed = np.zeros_like(plan.lam, dtype=bool)
    names = [contact.name for contact in SMALL.contacts]
    for name, first, last in best.windows:
        closed[first : last + 1, names.index(name)] = True
    np.testing.assert_array_equal(closed, plan.lam > 0)


def test_impossible_numbers_are_refused() -> None:
    for wrong in ({"starts": 0}, {"first_start": -1}, {"starts": 2.5}):
        with pytest.raises(OptionError, match="start"):
            load_method("mpcc").open(SMALL, wrong)


@pytest.mark.slow
def test_random_inputs_that_led_nowhere_are_not_corrected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are the same whatever a start is: the second start without a plan has only its own to correct."""
    drawn: list[tuple[int, ...]] = []

    def noted(scene, kernel, seed):
        drawn.append(seed)
        return random_plan(scene, kernel, seed)

    monkeypatch.setattr(finder, "random_plan", noted)
    monkeypatch.setattr(ModesProblem, "solve", lambda *_given, **_named: None)  # no modes have a plan
    opened = load_method("mpcc").open(SMALL)
    for _ in range(2):
        assert opened.solve(eps=None, warm_start=None, time_limit=600.0).trajectory is None
        assert len(drawn) == len(set(drawn)) == 6
