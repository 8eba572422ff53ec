"""`infeasible` is said of goals out of reach, soon, and not of goals within."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from formulations.ipopt import Iteration
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.method import SolveBudget
from formulations.transcription.solving import RestorationMonitor, nearest
from models.catalog import load_scene
from models.scene import Scene

METHODS = ("softplus_dc", "relaxed_lcp", "strict_lcp")
# Every method on what it finds hardest, one of them on all.
ALL_CASES, HARDEST = "relaxed_lcp", ("horizon", "speed", "two seconds", "elsewhere, stiffer")
SCENE = load_scene("three_cart")


def asked(cases: Iterable[str]) -> list[tuple[str, str]]:
    return [(case, method) for case in cases for method in METHODS if method == ALL_CASES or case in HARDEST]


def with_inputs(scene: Scene, *bounds: tuple[float, float]) -> Scene:
    inputs = (replace(item, lower=low, upper=high) for item, (low, high) in zip(scene.inputs, bounds, strict=True))
    return replace(scene, inputs=tuple(inputs))


IMPOSSIBLE = {
    "horizon": SCENE.with_task(steps=50),
    "bounds": with_inputs(SCENE, (-0.3, 0.3), (-0.3, 0.3)).with_task(steps=100, step=0.02),
    # The right cart must come from the right to push the middle one to the left, but can only be driven to the right.
    "no pull": with_inputs(SCENE, (-10.0, 10.0), (0.0, 10.0)).with_task(steps=100, step=0.02, goal=(2.0, 2.5, 4.5, 0.0, 0.0, 0.0)),
    # The middle cart at 9 m/s with both neighbours at rest: Ipopt stays in restoration.
    "speed": SCENE.with_task(steps=100, step=0.02, goal=(2.5, 3.5, 4.5, 0.0, 9.0, 0.0)),
}
POSSIBLE = {
    "two seconds": SCENE.with_task(steps=100, step=0.02),
    "to the left": SCENE.with_task(steps=100, step=0.02, goal=(1.5, 2.5, 4.5, 0.0, 0.0, 0.0)),
    "touching at the goal": SCENE.with_task(steps=100, step=0.02, goal=(2.6, 3.1, 3.6, 0.0, 0.0, 0.0)),
    "elsewhere, stiffer": SCENE.with_parameters(k=100.0).with_task(steps=100, step=0.02, start=(2.2, 3.0, 4.2, 0.0, 0.0, 0.0)),
}


def solved(method: str, scene: Scene) -> Solution:
    with load_method(method).open(scene) as session:
        return session.solve(eps=None if method == "strict_lcp" else 1e-3, warm_start=None, time_limit=300.0)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "method"), asked(IMPOSSIBLE))
def test_a_goal_out_of_reach_is_infeasible(case: str, method: str) -> None:
    solution = solved(method, IMPOSSIBLE[case])
    assert solution.outcome is Outcome.INFEASIBLE
    assert solution.trajectory is None
    assert solution.iterations < 1500, "a third of the iterations it may spend on a feasible problem"
    assert "misses" in solution.message


@pytest.mark.slow
@pytest.mark.parametrize(("case", "method"), asked(POSSIBLE))
def test_a_goal_within_reach_is_reached(case: str, method: str) -> None:
    solution = solved(method, POSSIBLE[case])
    assert solution.outcome is Outcome.SOLVED
    assert solution.trajectory is not None


@pytest.mark.parametrize("case", POSSIBLE)
def test_the_nearest_plan_reaches_what_is_within_reach(case: str) -> None:
    found = nearest(POSSIBLE[case], SolveBudget(300.0), 3000)
    assert not found.is_out_of_reach
    assert found.miss < 2e-3, "softplus contact, sharp: the worst seen where the solves converge is 6e-4"


def test_the_nearest_plan_says_what_it_misses() -> None:
    """One cart of 1 kg without damping, 2 N, 1 s of 100 steps: at full force it gets to sum of h^2 * 2 * n = 1.01 m, its goal is at 3 m."""
    no_push = SCENE.with_parameters(c=0.0).with_task(
        steps=100, start=(-50.0, 0.0, 50.0, 0.0, 0.0, 0.0), goal=(-47.0, 0.0, 50.0, 2.0, 0.0, 0.0)
    )
    found = nearest(with_inputs(no_push, (-2.0, 2.0), (-2.0, 2.0)), SolveBudget(300.0), 3000)
    assert found.is_out_of_reach
    assert found.miss == pytest.approx(1.99, abs=1e-4)
    assert found.words == "q1 by 1.99 m"
    np.testing.assert_allclose(found.plan.u[:, 0], 2.0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_false_infeasible_is_not_believed(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ipopt's `infeasible` is local: where the goal can be reached, the search goes on from a plan that does."""
    run, runs = CompiledModel.run, []

    def denied_once(self: CompiledModel, *args: object, **options: object):
        result = run(self, *args, **options)
        runs.append(result)
        return replace(result, outcome=Outcome.INFEASIBLE) if len(runs) == 1 else result

    monkeypatch.setattr(CompiledModel, "run", denied_once)
    assert solved(method, POSSIBLE["two seconds"]).outcome is Outcome.SOLVED
    assert len(runs) > 1


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_stubborn_infeasible_of_a_goal_within_reach_is_a_stall(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = CompiledModel.run

    def denied(self: CompiledModel, *args: object, **options: object):
        return replace(run(self, *args, **options), outcome=Outcome.INFEASIBLE)

    monkeypatch.setattr(CompiledModel, "run", denied)
    solution = solved(method, POSSIBLE["two seconds"])
    assert solution.outcome is Outcome.STALLED
    assert "can be reached" in solution.message


def test_restoration_monitor_counts_consecutive_restoration() -> None:
    def line(restoration: bool) -> Iteration:
        numbers = dict.fromkeys(("objective", "inf_pr", "inf_du", "mu", "step", "regularization", "alpha_du", "alpha_pr"), 0.0)
        return Iteration(iteration=0, restoration=restoration, trials=1, **numbers)

    monitor = RestorationMonitor()
    assert all(monitor(line(True)) for _ in range(99))
    assert monitor(line(False))
    assert all(monitor(line(True)) for _ in range(99))
    assert not monitor.is_out
    assert not monitor(line(True))
    assert monitor.is_out
