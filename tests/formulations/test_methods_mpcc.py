"""The method `mpcc` on the paper's scene and around it.

Every figure recomputed from a rollout of the compiled time step.
"""

from itertools import product

import numpy as np
import pytest
from example_scenes import example_scene

from benchmarks.suite.plans import pushed_row
from formulations.certificate.plan import certify_plan, certify_solution
from formulations.contact_modes.linear import linear_scene
from formulations.contact_modes.quadratic import ModesProblem
from formulations.contact_modes.search import mode_sequence
from formulations.methods.relaxed_lcp import RelaxedLCPSession
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory
from tests.formulations.transcription.rollouts import rolled_out

SCENE = load_scene("three_cart")
ARM = example_scene("two_link_arm")
TIME_LIMIT = 600.0  # wall seconds; never reached, only so that a broken solver ends
SMALL = SCENE.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)


LITTLE = SCENE.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=6, step=0.15
)
SHORT = load_scene("wall_pendulum").with_task(start=(0.07, 0.8), steps=9)


def solved(scene: Scene = SCENE, warm_start=None, **options) -> Solution:
    return solve_scene(scene, "mpcc", options=options, warm_start=warm_start, time_limit=TIME_LIMIT)


def check(solution: Solution, scene: Scene) -> None:
    """Solved, within its bounds, and its inputs lead to its own states and forces and to the goal through true contact."""
    assert solution.outcome is Outcome.SOLVED, solution.message
    plan = solution.trajectory
    kernel, task = load_kernel(scene), scene.task
    rollout = kernel.rollout(np.array(task.start), plan.u, task.step)
    for name in ("q", "v", "lam"):
        np.testing.assert_array_equal(getattr(plan, name), getattr(rollout, name))
    assert (
        np.linalg.norm(np.concatenate([rollout.q[-1], rollout.v[-1]]) - np.array(task.goal))
        <= 1e-10
    )
    assert (
        np.abs(plan.lam * (plan.lam - kernel.stiffness() * kernel.penetration(plan.q[:-1]))).max()
        == 0.0
    )
    for column, item in enumerate(scene.inputs):
        assert item.lower <= plan.u[:, column].min()
        assert plan.u[:, column].max() <= item.upper
    assert solution.cost == pytest.approx((plan.u**2).sum(), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [LITTLE, SHORT], ids=["three_cart", "wall_pendulum"])
def test_mpcc_few_steps_cheapest_of_all_modes(scene: Scene) -> None:
    """The banded quadratic program solves every choice of modes."""
    problem, pairs = ModesProblem(linear_scene(scene)), (scene.task.steps - 1) * scene.nc
    best = np.inf
    for modes in product((False, True), repeat=pairs):
        closed = np.reshape(modes, (-1, scene.nc))
        answer = problem.solve(np.vstack([np.zeros((1, scene.nc), bool), closed]), below=best)
        best = best if answer is None else min(best, answer.cost)
    assert solved(scene).cost == pytest.approx(best, rel=1e-9)


@pytest.fixture(scope="module")
def best() -> Solution:
    return solved()


@pytest.mark.slow
def test_without_search_the_figure_holds() -> None:
    solution = solved(search=False)
    check(solution, SCENE)
    assert solution.cost <= 490.56
    assert solution.residuals["windows_tried"] == 0


@pytest.mark.slow
def test_with_search_it_reaches_the_best_known_plan(best: Solution) -> None:
    check(best, SCENE)
    assert best.cost <= 490.5496
    left, right = mode_sequence(best.trajectory.lam > 0)
    assert left[0][1] == 179
    assert right == ((276, 307),)
    assert " S-stationary" in best.message
    assert best.residuals["least_biactive_multiplier"] >= 0
    assert best.residuals["windows_tried"] > 16


@pytest.mark.slow
def test_a_plan_of_its_own_is_left_as_it_is(best: Solution) -> None:
    """The modes of a plan given are tried first: no homotopy, no better neighbour."""
    again = solved(warm_start=best.trajectory)
    check(again, SCENE)
    assert again.iterations == 0
    assert again.cost == pytest.approx(best.cost, rel=1e-9)


def random_start(seed: int) -> Trajectory:
    """Piecewise constant inputs, up to 3 N, and what they lead to."""
    task = SCENE.task
    u = np.random.default_rng(seed).uniform(-3.0, 3.0, (10, 2))[
        np.arange(task.steps) * 10 // task.steps
    ]
    return rolled_out(SCENE, u)


@pytest.mark.slow
def test_two_pushes_become_one() -> None:
    """The modes of these random inputs lead to two pushes on the left (495.554), from which no single move helps."""
    solution = solved(warm_start=random_start(0))
    check(solution, SCENE)
    assert solution.iterations == 0, "no homotopy: it all came from the modes given"
    assert solution.cost <= 490.5496


@pytest.mark.slow
def test_one_push_becomes_two_though_that_is_dearer_at_first() -> None:
    """Moved by 0.6 m, one push on the left costs 630.7, and so do all that repeat it until the right cart comes later."""
    scene = SCENE.with_task(goal=(2.6, 3.6, 4.6, 0.0, 0.0, 0.0))
    solution = solved(scene)
    check(solution, scene)
    assert solution.cost is not None
    assert solution.cost <= 584.19
    assert solution.trajectory is not None
    assert [len(row) for row in mode_sequence(solution.trajectory.lam > 0)] == [2, 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "first", "cost", "source"),
    [
        (0, 273.65, 273.16, "loosened"),
        (3, 36.30, 35.34, "walked down from a cold start"),
        (2, 101.22, 101.21, None),
    ],
)
def test_a_row_of_carts_is_searched_around_other_modes(
    seed: int, first: float, cost: float, source: str | None
) -> None:
    """Four carts in 80 steps, pushed at random: a second source leads below the first, or else a third, or neither does, and the plan stays."""
    scene = pushed_row(seed, 4, 80)
    solution, alone = solved(scene), solved(scene, search=False)
    check(solution, scene)
    assert solution.iterations > alone.iterations, (
        "the other sources take iterations, the search none"
    )
    assert solution.cost is not None
    assert solution.cost <= cost
    assert ("Around modes of relaxed contact" in solution.message) == (source is not None)
    if source is not None:
        assert f"relaxed contact, {source}; around" in solution.message
        told = float(
            solution.message.split("softplus contact the cheapest plan costs ")[1]
            .split()[0]
            .rstrip(".")
        )
        assert cost < told <= first


@pytest.mark.slow
def test_two_contacts_are_searched_around_one_source() -> None:
    assert solved(SMALL).iterations == solved(SMALL, search=False).iterations


@pytest.mark.slow
def test_where_softplus_contact_leads_nowhere_relaxed_contact_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two fingers carry a disc: no softplus plan within half of `first_work`."""
    solve, walked = RelaxedLCPSession.solve, []
    monkeypatch.setattr(
        RelaxedLCPSession,
        "solve",
        lambda self, **given: walked.append(solve(self, **given)) or walked[-1],
    )
    scene = load_scene("two_finger").with_task(steps=100, step=0.005)
    solution = solved(scene, search_windows=5)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert [plan.outcome for plan in walked] == [Outcome.SOLVED]
    assert solution.cost is not None
    assert solution.cost * scene.task.step <= 45.62e-3


@pytest.mark.slow
def test_without_search_touching_pairs_are_switched_all_the_same() -> None:
    """The modes of the coarser grid touch at three steps, with multipliers of -5.9 at least."""
    scene = SCENE.with_task(steps=620, step=5.0 / 620)
    solution = solved(scene, search=False)
    check(solution, scene)
    assert solution.residuals["least_biactive_multiplier"] >= 0.0
    assert solution.trajectory is not None
    assert certify_plan(scene, solution.trajectory).b_stationary


@pytest.mark.slow
def test_a_plan_that_can_be_left_downhill_is_not_solved() -> None:
    """With no modes to try, the plan comes with the name of its class, and not as solved."""
    scene = SCENE.with_task(steps=620, step=5.0 / 620)
    solution = solved(scene, search=False, search_windows=0)
    assert solution.outcome is Outcome.STALLED
    assert solution.trajectory is not None
    assert solution.residuals["least_biactive_multiplier"] < -1.0
    assert "not B-stationary" in solution.message
    assert solution.certificate is not None, "and comes with what said so"
    assert solution.certificate.b_stationary is False
    assert certify_solution(scene, solution) is solution, "and nothing is certified twice"


@pytest.mark.slow
def test_a_search_without_time_still_switches_the_pairs_of_the_wrong_sign() -> None:
    scene = SCENE.with_task(steps=620, step=5.0 / 620)
    solution = solved(scene, search_share=0.0)
    check(solution, scene)
    assert solution.residuals["least_biactive_multiplier"] >= 0.0
    assert "others may be cheaper" in solution.message


@pytest.mark.slow
def test_a_search_ends_after_the_modes_it_may_try() -> None:
    solution = solved(search_windows=20)
    check(solution, SCENE)
    assert solution.residuals["windows_tried"] <= 21
    assert "others may be cheaper" in solution.message


@pytest.mark.parametrize("k", [30.0, 300.0, 3000.0])
def test_other_stiffnesses(k: float) -> None:
    scene = SMALL.with_parameters(k=k)
    check(solved(scene), scene)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [150, 1000])
def test_other_grids_cost_the_same_per_unit_of_time(steps: int) -> None:
    """T = 1000 goes by way of a coarser grid."""
    scene = SCENE.with_task(steps=steps, step=5.0 / steps)
    solution = solved(scene)
    check(solution, scene)
    assert solution.cost * scene.task.step == pytest.approx(4.9055, rel=5e-3)


@pytest.mark.slow
def test_a_nonlinear_scene_goes_by_ipopt() -> None:
    solution = solved(ARM)
    check(solution, ARM)
    strict = (
        load_method("strict_lcp").open(ARM).solve(eps=None, warm_start=None, time_limit=TIME_LIMIT)
    )
    assert solution.cost <= strict.cost * (1 + 1e-6)
    assert "Ipopt" in solution.message


@pytest.mark.slow
def test_an_unreachable_goal_has_no_plan() -> None:
    for scene in (SMALL.with_task(goal=(2.1, 2.7, 9.3, 0.0, 0.0, 0.0)), SMALL.with_task(steps=10)):
        solution = solved(scene)
        assert solution.outcome is Outcome.INFEASIBLE
        assert solution.trajectory is None
        assert "reaches the goal" in solution.message


def test_no_time_ends_in_a_time_limit() -> None:
    assert solve_scene(SCENE, "mpcc", time_limit=1e-3).outcome is Outcome.TIME_LIMIT


@pytest.mark.slow
def test_several_starts_keep_the_cheapest_and_tell_the_spread() -> None:
    alone, several = solved(SMALL), solved(SMALL, starts=4, seed=3)
    check(several, SMALL)
    assert several.cost <= alone.cost * (1 + 1e-12)
    assert several.residuals["starts_solved"] == 4
    assert several.residuals["dearest_start"] >= several.cost * (1 - 1e-9)
    assert "4 of 4 starts were solved" in several.message


@pytest.mark.slow
def test_a_stiff_contact_is_pushed_twice() -> None:
    """k = 300: one push on each side costs 4.98 J s, two on the left 4.53.

    No shift of an interval leads from one to the other.
    """
    scene = SCENE.with_parameters(k=300.0).with_task(steps=250, step=0.02)
    solution = solved(scene)
    check(solution, scene)
    assert solution.cost * scene.task.step <= 4.54
    assert len(mode_sequence(solution.trajectory.lam > 0)[0]) == 2
