"""A walk: from a loose eps to the one asked for, in steps that adapt to what they cost; it ends at the eps asked for, or says where."""

from itertools import pairwise

import pytest

from formulations.ipopt import IpoptResult
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from formulations.transcription.homotopy import Stage
from models.catalog import load_scene

SCENE = load_scene("three_cart").with_task(start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100)
LAST = {"relaxed_lcp": 1e-4, "softplus_dc": 1e-7}
FIRST = {"relaxed_lcp": 0.9, "softplus_dc": 1e-3}
METHODS = tuple(LAST)


def solved(name: str, scene=SCENE, **options: object) -> Solution:
    with load_method(name).open(scene, options) as session:
        return session.solve(eps=LAST[name], warm_start=None, time_limit=300.0)


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
