"""A walk: from a loose eps to the one asked for, in steps that adapt to what they cost.

It ends at the eps asked for, or says where. Long horizons by way of every second step, and so on
down; what a stage really starts from.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from formulations.ipopt import IpoptResult
from formulations.methods import relaxed_lcp, strict_lcp
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.homotopy import Stage
from formulations.transcription.solving import PlanSolver
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory, uniform_grid
from tests.formulations.transcription.rollouts import rolled_out

SCENE = load_scene("three_cart").with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)
LAST = {"relaxed_lcp": 1e-4, "softplus_dc": 1e-7}
FIRST = {"relaxed_lcp": 0.9, "softplus_dc": 1e-3}
METHODS = tuple(LAST)


def solved(name: str, scene=SCENE, **options: object) -> Solution:
    return solve_scene(scene, name, eps=LAST[name], options=options, time_limit=300.0)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, IpoptResult]]:
    """(eps, result) of every solve of a stage."""
    found: list[tuple[float, IpoptResult]] = []
    solve = Stage.solve

    def kept(self: Stage, eps: float, start, **more) -> IpoptResult:
        result = solve(self, eps, start, **more)
        found.append((eps, result))
        return result

    monkeypatch.setattr(Stage, "solve", kept)
    return found


@pytest.mark.parametrize("name", METHODS)
def test_it_goes_from_the_first_eps_to_the_last(name: str, steps):
    solution = solved(name, first_eps=FIRST[name])
    assert solution.outcome is Outcome.SOLVED
    asked = [eps for eps, _ in steps]
    assert (asked[0], asked[-1]) == (FIRST[name], LAST[name])
    assert asked == sorted(asked, reverse=True)
    assert len(asked) > 2
    assert solution.iterations == sum(result.iterations for _, result in steps)
    assert len(solution.history["objective"]) == len(solution.history["mu"]) >= solution.iterations


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_a_first_eps_that_is_no_larger_changes_nothing(name: str, steps):
    plain, same = solved(name), solved(name, first_eps=LAST[name])
    assert plain.trajectory.u.tobytes() == same.trajectory.u.tobytes()
    assert [eps for eps, _ in steps] == [LAST[name]] * len(steps)


@pytest.mark.slow
def test_cheap_steps_grow_and_failed_ones_shrink(monkeypatch: pytest.MonkeyPatch):
    """Of relaxed_lcp, whose eps falls by the square of the factor: 4 at first."""
    asked: list[float] = []
    solve = Stage.solve

    def no_long_steps(self: Stage, eps: float, start, **more) -> IpoptResult:
        result = solve(self, eps, start, **more)
        is_far = bool(asked) and eps < asked[-1] / 3.0
        if is_far:
            self._solver.last = None
            return IpoptResult(**{**result.__dict__, "outcome": Outcome.ITERATION_LIMIT})
        asked.append(eps)
        return result

    monkeypatch.setattr(Stage, "solve", no_long_steps)
    solution = solved("relaxed_lcp", first_eps=0.1)
    assert solution.outcome is Outcome.SOLVED
    assert asked[-1] == 1e-4
    assert max(before / after for before, after in pairwise(asked)) <= 3.0


@pytest.mark.slow
def test_a_walk_that_ends_early_hands_on_its_last_plan(monkeypatch: pytest.MonkeyPatch):
    solve = Stage.solve

    def none_below(self: Stage, eps: float, start, **more) -> IpoptResult:
        result = solve(self, eps, start, **more)
        if eps < 1e-2:
            self._solver.last = None
            return IpoptResult(**{**result.__dict__, "outcome": Outcome.ITERATION_LIMIT})
        return result

    monkeypatch.setattr(Stage, "solve", none_below)
    solution = solved("relaxed_lcp", first_eps=0.1)
    assert solution.outcome is Outcome.ITERATION_LIMIT
    assert "The walk to eps = 0.0001 ended at" in solution.message
    assert solution.trajectory is not None
    assert 1e-4 < solution.residuals["complementarity"] <= 0.1


def test_no_more_iterations_than_allowed():
    for most in (30, 60):
        assert solved("relaxed_lcp", first_eps=0.9, max_iterations=most).iterations <= most


STEPS = 40
STEP = 0.1
CARTS = load_scene("three_cart").with_task(steps=STEPS, step=STEP)


def line(ends: float) -> Trajectory:
    """Carts that go evenly to `ends` of the way, whatever pushes them: no plan of the scene."""
    start, goal = (
        np.array(state, dtype=float)[: CARTS.nq] for state in (CARTS.task.start, CARTS.task.goal)
    )
    share = np.linspace(0.0, ends, STEPS + 1)[:, None]
    q = start + share * (goal - start)
    v = np.full((STEPS + 1, CARTS.nq), 5.0)
    return Trajectory(
        t=uniform_grid(STEP, STEPS),
        q=q,
        v=v,
        u=np.zeros((STEPS, CARTS.nu)),
        lam=np.zeros((STEPS, CARTS.nl)),
    )


@pytest.fixture(scope="module")
def cold():
    return solve_scene(CARTS, "strict_lcp")


def test_a_broken_plan_is_no_start_and_changes_nothing(cold):
    """Bit for bit the same as cold, whichever broken plan was given."""
    with load_method("strict_lcp").open(CARTS) as session:
        assert session.start_used(None) is None
        assert session.start_used(line(1.0)) is None
        found = session.solve(eps=None, warm_start=line(1.0), time_limit=600.0)
    assert cold.trajectory is not None
    assert found.trajectory is not None
    assert (found.outcome, found.iterations, found.cost, found.message) == (
        cold.outcome,
        cold.iterations,
        cold.cost,
        cold.message,
    )
    for name in ("q", "v", "u", "lam"):
        assert np.array_equal(getattr(found.trajectory, name), getattr(cold.trajectory, name))


def test_a_plan_that_is_one_is_started_from(cold):
    with load_method("strict_lcp").open(CARTS) as session:
        assert session.start_used(cold.trajectory) is cold.trajectory
    with load_method("softplus_dc").open(CARTS) as session:  # others start from what they are given
        broken = line(1.0)
        assert session.start_used(broken) is broken


def test_a_plan_of_another_grid_is_refused_before_it_is_looked_at(cold):
    with (
        load_method("strict_lcp").open(CARTS) as session,
        pytest.raises(TrajectoryError, match="warm start"),
    ):
        session.solve(
            eps=None,
            warm_start=replace(line(1.0), t=uniform_grid(2 * STEP, STEPS)),
            time_limit=60.0,
        )


@pytest.mark.slow
def test_a_plan_that_leads_nowhere_with_ipopts_own_barrier_is_tried_once_more_from_inside_its_bounds(
    monkeypatch,
):
    """A nonlinear scene's attack goes by way of looser bounds, the first of them from the plan: cut off here after so many iterations that it cannot be done."""
    scene = load_scene("acrobot_limits").with_task(steps=100, step=0.01)
    plan = rolled_out(scene, np.zeros((100, scene.nu)))
    asked: list[tuple[int, float, float]] = []

    def attempt(self, budget, options, own=PlanSolver.attempt, **named):
        begun = budget.iterations
        result = own(self, budget, options, **named)
        asked.append(
            (
                options["max_iter"] - begun,
                options.get("bound_push", -1.0),
                budget.iterations - begun,
            )
        )
        return result

    monkeypatch.setattr(strict_lcp, "_FROM_PLAN", 3)
    monkeypatch.setattr(PlanSolver, "attempt", attempt)
    found = solve_scene(scene, "strict_lcp", warm_start=plan)
    inside = strict_lcp.StrictLCPOptions().cold_barrier()["bound_push"]
    assert found.outcome is Outcome.SOLVED, found.message
    (first, its_push, spent), (second, inside_push, _) = asked[:2]
    assert (first, spent) == (3, 3)
    assert second > 3
    assert its_push != inside_push == inside


EPS = 1e-2


def relaxed(scene, start):
    return solve_scene(scene, "relaxed_lcp", eps=EPS, warm_start=start, time_limit=120.0)


def pushed(scene):
    """A motion under a constant push: a start that is no answer."""
    return rolled_out(scene, np.full((scene.task.steps, scene.nu), 0.5))


@pytest.mark.parametrize("warm", [False, True])
def test_the_same_plan_by_way_of_coarser_grids(monkeypatch, warm):
    scene = load_scene("wall_pendulum")
    start = pushed(scene) if warm else None
    at_once = relaxed(scene, start)
    grids = []
    of_class = PlanSolver.attempt

    def attempt(self, budget, *arguments, **options):
        grids.append(self._scene.task.steps)
        return of_class(self, budget, *arguments, **options)

    monkeypatch.setattr(PlanSolver, "attempt", attempt)
    monkeypatch.setattr(relaxed_lcp, "_LONG", 12)
    monkeypatch.setattr(relaxed_lcp, "_SHORT", 6)
    by_grids = relaxed(scene, start)
    assert grids == [5, 10, 20]
    assert by_grids.outcome is at_once.outcome is Outcome.SOLVED
    assert by_grids.cost == pytest.approx(at_once.cost, rel=1e-6)
    assert by_grids.residuals["dynamics_defect"] < 1e-6
    assert by_grids.residuals["complementarity"] <= EPS + 1e-6
    # an iteration of each grid, and the starting point of each
    assert len(by_grids.history["objective"]) == by_grids.iterations + len(grids)


def test_a_grid_without_a_plan_leaves_the_start_as_it_was(monkeypatch):
    scene = load_scene("wall_pendulum")
    start = pushed(scene)
    at_once = relaxed(scene, start)
    monkeypatch.setattr(relaxed_lcp, "_LONG", 12)
    monkeypatch.setattr(relaxed_lcp.RelaxedLCPSession, "_from_coarser_grid", lambda *_: None)
    again = relaxed(scene, start)
    assert again.iterations == at_once.iterations
    np.testing.assert_array_equal(again.trajectory.u, at_once.trajectory.u)
