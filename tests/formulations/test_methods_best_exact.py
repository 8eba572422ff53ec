"""`best_exact`: mpcc where contacts are open or closed, else several ways, of which the cheapest plan is kept."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from formulations.methods import best_exact
from formulations.methods.best_exact import departure
from formulations.pipelines import find_pipeline, load_method, pipelines_for
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid

ROOT = Path(__file__).parents[2]
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


@pytest.mark.slow
def test_all_ways_are_told_and_the_cheapest_is_kept():
    found = solved(SMALL, all_ways=True)
    assert [attempt.number for attempt in found.starts] == [0, 1, 2, 3, 4]
    assert found.starts[0].start == "mpcc"
    costs = [attempt.cost for attempt in found.starts if attempt.outcome is Outcome.SOLVED and attempt.cost is not None]
    assert len(costs) == 5
    assert found.cost == pytest.approx(min(costs), rel=1e-12)
    assert "The best of 5 ways, by mpcc" in found.message
    assert found.seconds.wall > 0.0


def test_a_walk_without_a_plan_is_not_followed(monkeypatch: pytest.MonkeyPatch):
    """Relaxed contact that has no plan at its loosest eps is not tried at a tighter one; the ways by softplus contact are left."""
    from formulations.methods.relaxed_lcp import RelaxedLCPSession

    def none(self: RelaxedLCPSession, **_: object) -> Solution:
        return Solution(method="relaxed_lcp", outcome=Outcome.ITERATION_LIMIT, message="nothing.")

    monkeypatch.setattr(RelaxedLCPSession, "solve", none)
    found = solved(SMALL, all_ways=True)
    assert [attempt.start.split()[0] for attempt in found.starts] == ["mpcc", "relaxed_lcp", "softplus_dc", "softplus_multiple_shooting"]
    assert found.starts[1].cost is None


def _finer(inputs: float, fine: int = 50) -> Trajectory:
    """A plan whose states are the true motion, stepped `fine` times in each of its steps."""
    u = np.full((40, 2), inputs) * [1.0, -1.0]
    motion = load_kernel(SMALL).rollout(np.array(SMALL.task.start), np.repeat(u, fine, axis=0), 0.05 / fine)
    return Trajectory(t=uniform_grid(0.05, 40), q=motion.q[::fine], v=motion.v[::fine], u=u, lam=motion.lam[::fine])


def _ending_at(plan: Trajectory, **limits: float) -> Scene:
    """The small scene with the plan's own end for a goal, and no limits that count but these."""
    scene = SMALL.with_task(goal=(*plan.q[-1], *plan.v[-1]), steps=40, step=0.05)
    values = dict.fromkeys((limit.metric for limit in scene.limits), 1e9) | limits
    return replace(scene, limits=tuple(replace(scene.limits[0], metric=name, value=value) for name, value in values.items()))


def test_a_plan_of_the_true_motion_does_not_depart():
    plan = _finer(1.5)
    assert (plan.lam > 0.0).any()
    scene = _ending_at(plan, replay_error=1e-6, replay_terminal_position_error=1e-6, feedback_share=1e-6)
    assert departure(scene, plan) < 1e-4


def test_what_departs_is_counted_in_the_limits_of_the_scene():
    """Each limit by itself, and the largest of all; twice the limit, half the number. Coarser steps depart by what they are wrong."""
    coarse = _finer(1.5, fine=1)
    names = ("replay_error", "replay_terminal_position_error", "replay_terminal_velocity_error", "feedback_share")
    alone = {name: departure(_ending_at(coarse, **{"feedback_share": 1e9, name: 0.01}), coarse) for name in names}
    assert all(value > 1e-2 for value in alone.values())
    assert departure(_ending_at(coarse, **dict.fromkeys(names, 0.01)), coarse) == pytest.approx(max(alone.values()))
    assert departure(_ending_at(coarse, replay_error=0.02, feedback_share=1e9), coarse) == pytest.approx(alone["replay_error"] / 2.0)
    assert departure(_ending_at(coarse), coarse) == pytest.approx(alone["feedback_share"] * 0.01 / 0.5), (
        "half of the inputs, where no limit is set"
    )
    finer = _finer(1.5, fine=10)
    assert departure(_ending_at(finer, feedback_share=0.01), finer) < 0.25 * alone["feedback_share"]


def test_a_motion_that_leaves_every_bound_is_lost():
    """Springs that are far too stiff for a fiftieth of the step."""
    plan = _finer(1.5)
    assert departure(_ending_at(plan).with_parameters(k=3e13), plan) == 1e6


@pytest.fixture(scope="module")
def remembering():
    """load_method, whose sessions answer as they did to the same questions before."""
    answers: dict[object, Solution] = {}

    @contextmanager
    def opened(name: str, scene: Scene, options: object):
        with load_method(name).open(scene, options) as session:

            def solve(*, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
                asked = (name, repr(options), eps, warm_start and (warm_start.u.tobytes(), warm_start.q.tobytes()))
                if asked not in answers:
                    answers[asked] = session.solve(eps=eps, warm_start=warm_start, time_limit=time_limit)
                return answers[asked]

            yield SimpleNamespace(solve=solve)

    return lambda name: SimpleNamespace(open=partial(opened, name), accepts=load_method(name).accepts)


@pytest.mark.slow
@pytest.mark.parametrize("followed", ["all", "dearer", "none"])
def test_the_cheapest_plan_that_is_followed_is_taken(monkeypatch: pytest.MonkeyPatch, remembering, followed: str):
    """Contacts that are damped a little have no modes, and several ways: the cheapest plan is the first's, 852.4, the next 853.3, then 856.8."""
    scene = replace(SMALL, contacts=tuple(replace(contact, damping=sp.Float(0.5)) for contact in SMALL.contacts))
    kernel = load_kernel(scene)

    def departs(_scene: Scene, plan: Trajectory) -> float:
        return 2.0 if followed == "none" or (followed == "dearer" and kernel.cost(plan.q, plan.v, plan.u) < 853.0) else 0.5

    monkeypatch.setattr(best_exact, "departure", departs)
    monkeypatch.setattr(best_exact, "load_method", remembering)
    found = solved(scene)
    costs = sorted(attempt.cost for attempt in found.starts if attempt.cost is not None)
    assert found.cost == costs[1 if followed == "dearer" else 0]
    assert ("by 2 times what the scene allows" in found.message) == (followed == "none")
    assert found.residuals["departure"] == (2.0 if followed == "none" else 0.5)


@pytest.mark.slow
def test_a_scene_with_friction_ends_where_the_best_known_way_does():
    """Relaxed contact from 1e-2 ends at 0.916; that of a loose first eps, and softplus contact, leave the choice where friction holds."""
    found = solved(load_scene("transport"))
    by = {attempt.start.partition(",")[0]: attempt.cost for attempt in found.starts}
    assert found.outcome is Outcome.SOLVED
    assert found.cost is not None
    assert found.cost <= by["relaxed_lcp from eps = 0.9"] <= 0.7063


@pytest.mark.slow
def test_what_relaxed_contact_passes_by_multiple_shooting_finds():
    """A finger that pushes a drawer shut, which glides the last part by itself: relaxed contact ends at 25.9 and 26.5, softplus walked down nowhere."""
    found = solved(load_scene(str(ROOT / "tests" / "scenes" / "drawer.py")))
    by = {attempt.start.split()[0]: attempt.cost for attempt in found.starts}
    assert found.outcome is Outcome.SOLVED
    assert found.cost == by["softplus_multiple_shooting"] <= 9.6
    assert min(attempt.cost for attempt in found.starts if attempt.start.startswith("relaxed_lcp") and attempt.cost) > 20.0
