"""The three transcription methods on the paper's scene: its rows, warm starts from anywhere, and what cannot be done."""

import numpy as np
import pytest
from example_scenes import solve

from formulations.method import Clock
from formulations.methods import strict_lcp
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.compiled import size_on_paper
from formulations.transcription.contact import ContactFormulation
from formulations.transcription.method import SolveBudget, Work
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.solving import PlanSolver
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import worst_case_violation
from models.scene import Scene
from models.trajectory import Trajectory

pytestmark = pytest.mark.slow

SCENE = load_scene("three_cart")
TIME_LIMIT = 600.0  # wall seconds; never reached, only so that a broken solver ends
METHODS = ("softplus_dc", "relaxed_lcp", "strict_lcp")

# Two carts in reach of each other and a second of time: contact is needed, and a solve takes half a
# second at most.
SMALL = SCENE.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)


def chain(
    method: str,
    schedule: tuple[float | None, ...],
    scene: Scene = SCENE,
    warm_start: Trajectory | None = None,
    **options,
) -> list[Solution]:
    found = []
    with load_method(method).open(scene, options) as session:
        for eps in schedule:
            found.append(session.solve(eps=eps, warm_start=warm_start, time_limit=TIME_LIMIT))
            warm_start = found[-1].trajectory
    return found


def discrete_terminal_error(solution: Solution, scene: Scene = SCENE) -> float:
    """Recomputed here: the plan's inputs through the plan's own time step with the true contact law."""
    plan = solution.trajectory
    replay = load_kernel(scene).rollout(np.array(scene.task.start), plan.u, scene.task.step)
    return float(
        np.linalg.norm(np.concatenate([replay.q[-1], replay.v[-1]]) - np.array(scene.task.goal))
    )


def physics(solution: Solution, scene: Scene = SCENE) -> float:
    """The paper's (10) over t = 0..T-1, with lam and phi at the same time."""
    plan, kernel = solution.trajectory, load_kernel(scene)
    return float(
        np.abs(plan.lam * (plan.lam - kernel.stiffness() * kernel.penetration(plan.q[:-1]))).sum()
    )


def descent_plan() -> Trajectory:
    """Softplus gradient descent as the paper ran it: its end is 0.2 m away from the goal."""
    plan = None
    for eps, count in ((1e-3, 15), (1e-5, 14), (1e-7, 11)):
        plan = solve(SCENE, "softplus_gd", eps, plan, iterations=count).trajectory
    return plan


@pytest.fixture(scope="module")
def softplus_rows() -> list[Solution]:
    return chain("softplus_dc", (1e-3, 1e-5, 1e-7))


@pytest.fixture(scope="module")
def relaxed_rows() -> list[Solution]:
    return chain("relaxed_lcp", (1e-2, 1e-3, 1e-4))


@pytest.fixture(scope="module")
def strict_rows(softplus_rows: list[Solution], relaxed_rows: list[Solution]) -> dict[str, Solution]:
    starts = {
        "cold": None,
        "softplus_dc": softplus_rows[-1].trajectory,
        "softplus_gd": descent_plan(),
        "relaxed_lcp": relaxed_rows[-1].trajectory,
    }
    return {
        name: chain("strict_lcp", (None,), warm_start=start)[0] for name, start in starts.items()
    }


def test_softplus_rows_are_those_of_the_paper(softplus_rows: list[Solution]) -> None:
    """Table I prints two digits of the cost.

    The three further figures were measured on this formulation (0.01, 0.1 %, 0.002).
    """
    rows = ((197.863, 2445.90, 0.449), (261.228, 625.14, 0.265), (339.524, 239.53, 0.119))
    for solution, (cost, sum_of_products, miss) in zip(softplus_rows, rows, strict=True):
        assert solution.outcome is Outcome.SOLVED
        assert solution.cost == pytest.approx(cost, abs=0.001)
        assert physics(solution) == pytest.approx(sum_of_products, abs=0.006)
        assert solution.residuals["physics"] == pytest.approx(physics(solution), rel=1e-12)
        assert discrete_terminal_error(solution) == pytest.approx(miss, abs=0.001)
        assert solution.residuals["terminal_error"] <= 1e-9
        assert solution.residuals["contact_law"] <= 1e-8


def test_relaxed_rows_tighten(relaxed_rows: list[Solution]) -> None:
    for solution, eps in zip(relaxed_rows, (1e-2, 1e-3, 1e-4), strict=True):
        assert solution.outcome is Outcome.SOLVED
        assert solution.residuals["complementarity"] <= eps + 1e-9
        assert solution.residuals["complementarity"] >= 0.9 * eps, (
            "the bound is used: a wider one would have been cheaper"
        )
        assert solution.residuals["force_sign"] <= 1e-9
        assert solution.residuals["terminal_error"] <= 1e-9
        assert (
            440 <= (solution.cost or 0) <= 500
        )  # cheating costs less: below the exact plans' 490.55 at 1e-2, about there at 1e-4
    costs = [solution.cost or 0.0 for solution in relaxed_rows]
    assert costs == sorted(costs)


@pytest.mark.parametrize("start", ["cold", "softplus_dc", "softplus_gd", "relaxed_lcp"])
def test_strict_rows_hold(strict_rows: dict[str, Solution], start: str) -> None:
    solution = strict_rows[start]
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert (
        physics(solution) <= 1e-9
    )  # the issue asks for 1e-3; modes that are decided leave rounding only
    assert solution.residuals["terminal_error"] <= 1e-8
    assert discrete_terminal_error(solution) <= 1e-8
    assert solution.residuals["discrete_terminal_error"] == pytest.approx(
        discrete_terminal_error(solution), abs=1e-12
    )
    assert (
        490.5495 <= solution.cost <= (510 if start == "cold" else 497)
    )  # no exact plan below the best known one


def test_one_pipeline_comes_near_the_best_known_plan(strict_rows: dict[str, Solution]) -> None:
    assert min(solution.cost or np.inf for solution in strict_rows.values()) <= 491


@pytest.mark.parametrize("eps", [1e-1, 1e-4, 1e-9])
def test_softplus_plans_never_violate_more_than_the_closed_form(eps: float) -> None:
    solution = chain("softplus_dc", (1e-1, eps), SMALL)[-1]
    plan, kernel = solution.trajectory, load_kernel(SMALL)
    products = plan.lam * (plan.lam - kernel.stiffness() * kernel.penetration(plan.q[:-1]))
    assert products.max() <= worst_case_violation(30.0, eps) * (1 + 1e-9)
    assert products.max() >= 0.5 * worst_case_violation(30.0, eps), (
        "the carts touch, so the worst place is nearly met"
    )


@pytest.mark.parametrize("method", METHODS)
def test_no_time_ends_in_a_time_limit(method: str) -> None:
    solution = solve_scene(
        SCENE, method, eps=None if method == "strict_lcp" else 1e-3, time_limit=1e-3
    )
    assert solution.outcome is Outcome.TIME_LIMIT
    assert solution.seconds.wall < 30


@pytest.mark.parametrize("method", METHODS)
def test_iterations_are_counted_and_limited(method: str) -> None:
    solution = chain(method, (None if method == "strict_lcp" else 1e-3,), SMALL, max_iterations=2)[
        0
    ]
    assert solution.outcome is Outcome.ITERATION_LIMIT
    assert solution.iterations == 2


def test_a_strict_attack_cut_off_still_has_its_modes_solved() -> None:
    """Forty iterations do not finish the attack, but the modes they leave have a plan.

    It is exact, and says how it came about.
    """
    whole, cut = (
        chain("strict_lcp", (None,), SMALL)[0],
        chain("strict_lcp", (None,), SMALL, attack_iterations=40)[0],
    )
    assert cut.outcome is Outcome.SOLVED
    assert "cut off" in cut.message
    assert "cut off" not in whole.message
    assert physics(cut, SMALL) <= 1e-9


def test_a_strict_attack_may_do_so_much_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted in iterations times unknowns: cut off there, as by its option, and its modes tried."""
    monkeypatch.setattr(
        strict_lcp,
        "_ATTACK",
        Work(40.5 * size_on_paper(SMALL, ContactFormulation.COMPLEMENTARITY).unknowns, 1),
    )
    by_work = chain("strict_lcp", (None,), SMALL)[0]
    monkeypatch.setattr(strict_lcp, "_ATTACK", Work(0.0, 1000))
    by_option = chain("strict_lcp", (None,), SMALL, attack_iterations=40)[0]
    assert "cut off" in by_work.message
    assert (by_work.iterations, by_work.cost) == (by_option.iterations, by_option.cost)


@pytest.mark.parametrize(
    ("change", "at_least"),
    [({"k": 300.0}, 1.0), ({"c": 3.0}, 1.0), ({"m": 2.0}, 1.0), ({"d": 0.45}, 1.0)],
)
def test_every_parameter_reaches_the_plan(change: dict[str, float], at_least: float) -> None:
    """Stiffer, more damped, heavier, shorter carts: another plan, another cost."""
    before, after = (
        chain("strict_lcp", (None,), SMALL)[0],
        chain("strict_lcp", (None,), SMALL.with_parameters(**change))[0],
    )
    assert before.outcome is after.outcome is Outcome.SOLVED
    assert abs((after.cost or 0) - (before.cost or 0)) >= at_least


def test_a_tightened_session_finds_what_a_fresh_one_finds() -> None:
    """Moving the mutable Param is the same problem as building with it: the convex half of the carts has one answer."""
    tightened = chain("softplus_dc", (1e-1, 1e-3), SMALL)[-1]
    fresh = chain("softplus_dc", (1e-3,), SMALL)[0]
    assert tightened.cost == pytest.approx(fresh.cost, rel=1e-7)


@pytest.mark.parametrize(("contact", "shift"), [(0, -2), (0, 2), (1, -1), (1, 1)])
def test_wrong_modes_are_switched_by_their_multipliers(contact: int, shift: int) -> None:
    """A contact closed too early or too late costs.

    The multiplier of the force held at zero says so, and its mode is switched back.
    """
    best = chain("strict_lcp", (None,), SMALL)[0]
    assert best.trajectory is not None
    closed = PlanResiduals(SMALL).modes(best.trajectory)
    first = int(np.flatnonzero(closed[:, contact])[0])
    closed[min(first, first + shift) : max(first, first + shift), contact] = shift < 0
    costs = []
    for switches in (0, 20):
        solver = PlanSolver(
            SMALL, ContactFormulation.COMPLEMENTARITY, strict_lcp.StrictLCPOptions(), Clock()
        )
        solver.prepare(1e-4, None)
        costs.append(solver.with_fixed_modes(switches).solve(SolveBudget(60.0), closed).objective)
    assert costs[0] > (best.cost or 0) * (1 + 1e-6)
    assert costs[1] == pytest.approx(best.cost, rel=1e-9)
