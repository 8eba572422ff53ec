"""How a cold start begins: a goal let go first, contact that is softer first.

Stages that end without a plan; eps counted in the scene's length.
"""

from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations import ContactFormulation, build_model, load_plan
from formulations.ipopt import Iteration, compile_model
from formulations.methods import relaxed_lcp, softplus_dc
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import set_relaxation
from formulations.transcription.method import SolveBudget, Work
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.solving import Monitor, plan_with_goal_released
from models.catalog import load_scene
from models.contact_law import ContactLaw as ForceLaw
from tests.formulations.transcription.rollouts import rolled_out

pytestmark = pytest.mark.slow

EPS = 1e-3


def line(inf_du: float) -> Iteration:
    numbers = dict.fromkeys(
        ("objective", "inf_pr", "mu", "step", "regularization", "alpha_du", "alpha_pr"), 1.0
    )
    return Iteration(iteration=1, restoration=False, inf_du=inf_du, trials=1, **numbers)


def test_multipliers_that_run_away_stop_a_cold_start():
    monitor = Monitor(watches_goal=True)
    assert monitor(line(1e9))
    assert not monitor.has_lost_goal
    assert not monitor(line(1e13))
    assert monitor.has_lost_goal


def test_a_goal_that_is_let_go_is_still_drawn_to():
    """Three carts, whose cost says nothing of the goal: the plan keeps its dynamics, and ends near the goal but not on it."""
    scene = load_scene("three_cart")
    budget = SolveBudget(60.0)
    plan = plan_with_goal_released(scene, EPS, budget, {"max_iter": 200})
    assert plan is not None
    found = PlanResiduals(scene).of(plan, ForceLaw.SOFTPLUS, EPS)
    assert found["dynamics_defect"] < 1e-8
    assert found["contact_law"] < 1e-6
    assert 1e-3 < found["terminal_error"] < 0.35
    assert budget.iterations > 0


def test_a_cold_start_called_infeasible_is_begun_again_with_the_goal_let_go(monkeypatch):
    """Ipopt's word is local.

    Here it is put into its mouth once, so that the test does not hang on its version. The second
    start has a plan.
    """
    run, runs = CompiledModel.run, []

    def denied_once(self, *arguments, **options):
        runs.append(run(self, *arguments, **options))
        return replace(runs[-1], outcome=Outcome.INFEASIBLE) if len(runs) == 1 else runs[-1]

    monkeypatch.setattr(CompiledModel, "run", denied_once)
    solution = solve_scene(load_scene("cart_pole_walls"), "softplus_dc", eps=EPS, time_limit=300.0)
    assert solution.outcome is Outcome.SOLVED
    assert len(runs) == 3  # the first guess, the goal let go, the goal itself from there


def test_what_misses_its_own_time_step_starts_no_other_stage(monkeypatch):
    """A stage cut off after one iteration, which is taken for broken: it hands nothing on, and a harder one is not tried from the same start."""
    monkeypatch.setattr(softplus_dc, "_WORK", Work(0.0, 1))
    monkeypatch.setattr(softplus_dc, "_BROKEN", -1.0)
    scene = load_scene("three_cart").with_task(steps=200, step=0.025)
    with load_method("softplus_dc").open(scene) as session:
        first = session.solve(eps=EPS, warm_start=None, time_limit=60.0)
        assert first.outcome is Outcome.SOLVED
        assert first.trajectory is not None
        cut = session.solve(eps=1e-5, warm_start=first.trajectory, time_limit=60.0)
        assert (cut.outcome, cut.trajectory, cut.cost) == (Outcome.ITERATION_LIMIT, None, None)
        assert "it is not a plan" in cut.message
        harder = session.solve(eps=1e-7, warm_start=first.trajectory, time_limit=60.0)
        assert (harder.outcome, harder.trajectory, harder.iterations) == (Outcome.STALLED, None, 0)
        assert "Not tried" in harder.message
        softer = session.solve(eps=5e-4, warm_start=first.trajectory, time_limit=60.0)
        assert softer.iterations > 0


def test_the_work_of_a_soft_stage_is_counted_in_nonzeros(monkeypatch):
    """Those of its own model: friction and many contacts make an iteration dearer than its unknowns say."""
    scene = load_scene("three_cart").with_task(steps=200, step=0.025)
    nonzeros = compile_model(build_model(scene, ContactFormulation.SOFTPLUS, eps=1e-5)).nonzeros
    monkeypatch.setattr(softplus_dc, "_WORK", Work(7.5 * nonzeros, 1))
    with load_method("softplus_dc").open(scene) as session:
        first = session.solve(eps=EPS, warm_start=None, time_limit=60.0)
        cut = session.solve(eps=1e-5, warm_start=first.trajectory, time_limit=60.0)
    assert first.outcome is Outcome.SOLVED
    assert (cut.outcome, cut.iterations) == (Outcome.ITERATION_LIMIT, 7 + 7), (
        "directly, and half way"
    )


def test_a_stage_that_leads_from_a_plan_to_none_goes_half_way_first(monkeypatch):
    """Three carts from 1e-2 to 1e-7: about 200 iterations directly, 10 and 9 by the geometric mean of the two."""
    scene = load_scene("three_cart")
    with load_method("softplus_dc").open(scene) as session:
        first = session.solve(eps=1e-2, warm_start=None, time_limit=60.0)
        monkeypatch.setattr(softplus_dc, "_WORK", Work(0.0, 40))
        found = session.solve(eps=1e-7, warm_start=first.trajectory, time_limit=60.0)
        assert found.outcome is Outcome.SOLVED
        assert "eps = 3.16228e-05" in found.message
        assert 40 < found.iterations < 40 + 2 * 40
        assert len(found.history["inf_pr"]) >= found.iterations, "all that was tried is told"
        assert found.residuals["contact_law"] < 1e-6, "at the eps that was asked for"
    with load_method("softplus_dc").open(scene, {"max_iterations": 45}) as session:
        first = session.solve(eps=1e-2, warm_start=None, time_limit=60.0)
        few = session.solve(eps=1e-7, warm_start=first.trajectory, time_limit=60.0)
        assert few.iterations <= 45, "no more iterations than the stage may have"
    with load_method("softplus_dc").open(scene) as session:
        stranger = session.solve(eps=1e-7, warm_start=first.trajectory, time_limit=60.0)
        assert stranger.iterations <= 40, "of a plan that is not of this session no eps is known"


def test_a_relaxed_stage_without_a_plan_ends_the_chain_from_that_start(monkeypatch):
    """Cold too, since plans of a smaller eps are among those of a larger one.

    Infeasible stays infeasible.
    """
    monkeypatch.setattr(relaxed_lcp, "_COLD", Work(0.0, 2))
    monkeypatch.setattr(relaxed_lcp, "_SOON", 2)
    monkeypatch.setattr(relaxed_lcp, "_BROKEN", -1.0)
    scene = load_scene("three_cart").with_task(steps=100, step=0.05)
    with load_method("relaxed_lcp").open(scene) as session:
        cut = session.solve(eps=1e-2, warm_start=None, time_limit=60.0)
        assert (cut.outcome, cut.trajectory) == (Outcome.ITERATION_LIMIT, None)
        assert cut.iterations == 6, "as asked for, softer, and as asked for again"
        harder = session.solve(eps=1e-3, warm_start=None, time_limit=60.0)
        assert (harder.outcome, harder.iterations) == (Outcome.STALLED, 0)
        assert "Not tried" in harder.message
        monkeypatch.setattr(relaxed_lcp, "_COLD", Work(5e6, 1000))
        softer = session.solve(eps=1e-1, warm_start=None, time_limit=60.0)
        assert softer.outcome is Outcome.SOLVED
        assert softer.trajectory is not None
        warm = session.solve(eps=1e-3, warm_start=softer.trajectory, time_limit=60.0)
        assert warm.outcome is Outcome.SOLVED, "another start is another matter"


def test_out_of_reach_is_said_once():
    """A horizon too short for the goal: what holds for eps = 1e-2 holds below it."""
    hasty = load_scene("three_cart").with_task(steps=50)
    with load_method("relaxed_lcp").open(hasty) as session:
        first = session.solve(eps=1e-2, warm_start=None, time_limit=60.0)
        second = session.solve(eps=1e-3, warm_start=None, time_limit=60.0)
    assert (first.outcome, second.outcome) == (Outcome.INFEASIBLE, Outcome.INFEASIBLE)
    assert first.iterations > 0
    assert second.iterations == 0


def test_one_eps_is_one_law_everywhere():
    """Softplus contact and regularised friction of two fingers: the compiled motion meets the equations of numpy and of Pyomo."""
    scene = replace(load_scene("two_finger_lift"), length=0.1).with_task(steps=6)
    u = np.random.default_rng(3).uniform(-0.2, 0.2, size=(6, scene.nu))
    plan = rolled_out(scene, u, ForceLaw.SOFTPLUS, EPS)
    found = PlanResiduals(scene).of(plan, ForceLaw.SOFTPLUS, EPS)
    assert found["contact_law"] < 1e-12
    assert found["regularised_friction"] < 1e-12
    assert found["dynamics_defect"] < 1e-12
    model = build_model(scene, ContactFormulation.SOFTPLUS, eps=0.5)
    set_relaxation(model, EPS)
    load_plan(model, plan)
    for family in ("contact_softplus", "friction_regularised", "velocity_step"):
        rows = model.component(f"constraint_{family}").values()
        assert max(abs(pyo.value(row.body) - pyo.value(row.upper)) for row in rows) < 1e-12


def cold(scene: str, eps: float, time_limit: float = 300.0, **options: object) -> Solution:
    return solve_scene(
        load_scene(scene), "relaxed_lcp", eps=eps, options=options, time_limit=time_limit
    )


@pytest.fixture(scope="module")
def hopper() -> Solution:
    return cold("hopper", 1e-2)


def test_the_plan_is_one_at_the_eps_asked_for(hopper: Solution):
    assert hopper.outcome is Outcome.SOLVED
    assert "It began softer, at eps = 0.1" in hopper.message
    assert hopper.residuals["complementarity"] <= 1e-2 * (1.0 + 1e-6)
    assert hopper.residuals["dynamics_defect"] < 1e-8


def test_all_iterations_are_told(hopper: Solution):
    assert hopper.iterations > 150
    assert len(hopper.history["objective"]) == len(hopper.history["inf_pr"])
    assert 0 <= len(hopper.history["objective"]) - hopper.iterations <= 5, (
        "each solve tells its first point too"
    )
    assert hopper.solver
    assert hopper.seconds.wall >= hopper.seconds.linear_algebra > 0.0


def test_the_multipliers_of_the_plan_are_there_for_the_next_stage(hopper: Solution):
    with load_method("relaxed_lcp").open(load_scene("hopper")) as session:
        first = session.solve(eps=1e-2, warm_start=None, time_limit=300.0)
        second = session.solve(eps=1e-4, warm_start=first.trajectory, time_limit=300.0)
    assert second.outcome is Outcome.SOLVED
    assert second.iterations < 100


def test_what_is_quick_begins_where_it_was_asked_to():
    found = cold("acrobot_limits", 1e-2)
    assert found.outcome is Outcome.SOLVED
    assert "softer" not in found.message


def test_no_more_iterations_than_allowed():
    for most in (40, 170, 200):
        found = cold("hopper", 1e-2, max_iterations=most)
        assert found.outcome is Outcome.ITERATION_LIMIT
        assert found.iterations <= most
        assert ("softer" in found.message) == (most > 150), (
            "with nothing left there is no other start, and what was found is kept"
        )


def test_from_a_small_eps_it_comes_back_through_all_between():
    found = cold("hopper", 1e-3)
    assert found.outcome is Outcome.SOLVED
    assert "It began softer" in found.message
    assert found.residuals["complementarity"] <= 1e-3 * (1.0 + 1e-6)
