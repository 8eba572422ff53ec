"""A start without a plan that leads nowhere soon begins softer, within the iterations that the stage has, and ends at the eps it was asked for."""

import pytest

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene


def cold(scene: str, eps: float, time_limit: float = 300.0, **options: object) -> Solution:
    with load_method("relaxed_lcp").open(load_scene(scene), options) as session:
        return session.solve(eps=eps, warm_start=None, time_limit=time_limit)


@pytest.fixture(scope="module")
def hopper() -> Solution:
    return cold("hopper", 1e-2)


@pytest.mark.slow
def test_the_plan_is_one_at_the_eps_asked_for(hopper: Solution):
    assert hopper.outcome is Outcome.SOLVED
    assert "It began softer, at eps = 0.1" in hopper.message
    assert hopper.residuals["complementarity"] <= 1e-2 * (1.0 + 1e-6)
    assert hopper.residuals["dynamics_defect"] < 1e-8


def test_all_iterations_are_told(hopper: Solution):
    assert hopper.iterations > 150
    assert len(hopper.history["objective"]) == len(hopper.history["inf_pr"])
    assert 0 <= len(hopper.history["objective"]) - hopper.iterations <= 5, "each solve tells its first point too"
    assert hopper.solver
    assert hopper.seconds.wall >= hopper.seconds.linear_algebra > 0.0


@pytest.mark.slow
def test_the_multipliers_of_the_plan_are_there_for_the_next_stage(hopper: Solution):
    with load_method("relaxed_lcp").open(load_scene("hopper")) as session:
        first = session.solve(eps=1e-2, warm_start=None, time_limit=300.0)
        second = session.solve(eps=1e-4, warm_start=first.trajectory, time_limit=300.0)
    assert second.outcome is Outcome.SOLVED
    assert second.iterations < 100


@pytest.mark.slow
def test_what_is_quick_begins_where_it_was_asked_to():
    found = cold("acrobot_limits", 1e-2)
    assert found.outcome is Outcome.SOLVED
    assert "softer" not in found.message


@pytest.mark.slow
def test_no_more_iterations_than_allowed():
    for most in (40, 170, 200):
        found = cold("hopper", 1e-2, max_iterations=most)
        assert found.outcome is Outcome.ITERATION_LIMIT
        assert found.iterations <= most
        assert ("softer" in found.message) == (most > 150), "with nothing left there is no other start, and what was found is kept"


@pytest.mark.slow
def test_from_a_small_eps_it_comes_back_through_all_between():
    found = cold("push_box", 1e-3)
    assert found.outcome is Outcome.SOLVED
    assert "It began softer" in found.message
    assert found.residuals["complementarity"] <= 1e-3 * (1.0 + 1e-6)
