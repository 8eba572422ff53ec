"""`best_exact`: mpcc where contacts are open or closed, else several ways, of which the cheapest plan is kept."""

import pytest

from formulations.pipelines import find_pipeline, load_method, pipelines_for
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.scene import Scene

SMALL = load_scene("three_cart").with_task(start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100)


def solved(scene: Scene, name: str = "best_exact", **options: object) -> Solution:
    with load_method(name).open(scene, options) as session:
        return session.solve(eps=None, warm_start=None, time_limit=600.0)


def test_open_and_closed_contacts_are_left_to_mpcc():
    ours, mpcc = solved(SMALL), solved(SMALL, "mpcc")
    assert ours.trajectory.u.tobytes() == mpcc.trajectory.u.tobytes()
    assert (ours.method, ours.outcome, ours.message, ours.starts) == ("best_exact", Outcome.SOLVED, mpcc.message, ())


@pytest.mark.parametrize(("scene", "like"), [("three_cart", "mpcc"), ("transport", "best_exact"), ("damped_collision", "best_exact")])
def test_a_campaign_solves_once_what_mpcc_and_best_exact_share(scene: str, like: str):
    """Legs that are equal have one key; where mpcc refuses, by friction or for want of inputs, best_exact has legs of its own."""
    legs = {pipeline.name: pipeline.legs for pipeline in pipelines_for(load_scene(scene))}
    assert legs["best_exact"] == find_pipeline(like).legs


def test_all_ways_are_told_and_the_cheapest_is_kept():
    found = solved(SMALL, all_ways=True)
    assert [attempt.number for attempt in found.starts] == [0, 1, 2, 3]
    assert found.starts[0].start == "mpcc"
    costs = [attempt.cost for attempt in found.starts if attempt.outcome is Outcome.SOLVED and attempt.cost is not None]
    assert len(costs) == 4
    assert found.cost == pytest.approx(min(costs), rel=1e-12)
    assert "The best of 4 ways, by mpcc" in found.message
    assert found.seconds.wall > 0.0


def test_a_walk_without_a_plan_is_not_followed(monkeypatch: pytest.MonkeyPatch):
    """Relaxed contact that has no plan at its loosest eps is not tried at a tighter one; the softplus walk is the only way left."""
    from formulations.methods.relaxed_lcp import RelaxedLCPSession

    def none(self: RelaxedLCPSession, **_: object) -> Solution:
        return Solution(method="relaxed_lcp", outcome=Outcome.ITERATION_LIMIT, message="nothing.")

    monkeypatch.setattr(RelaxedLCPSession, "solve", none)
    found = solved(SMALL, all_ways=True)
    assert [attempt.start.split()[0] for attempt in found.starts] == ["mpcc", "relaxed_lcp", "softplus_dc"]
    assert found.starts[1].cost is None


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("transport", 0.7063), ("push_box", 4808.4)])
def test_scenes_with_friction_end_where_the_best_known_way_does(name: str, most: float):
    found = solved(load_scene(name))
    assert found.outcome is Outcome.SOLVED
    assert found.cost is not None
    assert found.cost <= most
