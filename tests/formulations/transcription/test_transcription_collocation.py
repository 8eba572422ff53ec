"""Collocation in a plan's model: order through Pyomo, smooth and true contact, what is refused, and that the replay sees what was assumed. `infeasible` is said of goals out of reach, soon, and not of goals within."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations import ContactFormulation, ModelError, build_model, load_plan, read_plan
from formulations.ipopt import Iteration, compile_model, load, solve
from formulations.pipelines import load_method, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.method import SolveBudget
from formulations.transcription.solving import Monitor, nearest
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.collocation import defect, rollout
from models.errors import TrajectoryError
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory
from validate.judge.replay.run import replay
from validate.judge.score import score

OSCILLATOR = load_scene(str(Path(__file__).parents[2] / "scenes" / "oscillator.py"))
CARTS = load_scene("three_cart")
COLLOCATIONS = (Scheme.IMPLICIT_MIDPOINT, Scheme.RADAU_IIA_2)
ORDERS = {Scheme.SEMI_IMPLICIT_EULER: 1, Scheme.IMPLICIT_MIDPOINT: 2, Scheme.RADAU_IIA_2: 3}


def _coarse(steps: int):
    return CARTS.with_task(steps=steps, step=5.0 / steps)


def _solved(model) -> Trajectory:
    problem = compile_model(model)
    result = solve(problem, options={"tol": 1e-12})
    assert result.solved, result.message
    load(problem, result)
    return read_plan(model)


@pytest.mark.parametrize("scheme", ORDERS)
def test_the_model_of_an_oscillator_has_its_order(scheme: Scheme) -> None:
    """q = cos t: nothing is chosen, the equations alone make the motion."""
    errors = []
    for steps in (10, 20):
        free = OSCILLATOR.with_task(steps=steps, step=2.0 / steps, goal=(None, None))
        plan = _solved(build_model(free, scheme=scheme))
        assert plan.scheme is scheme
        errors.append(np.abs(plan.q[:, 0] - np.cos(plan.t)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(ORDERS[scheme], abs=0.25)


@cache
def _pushed(steps: int, scheme: Scheme) -> Trajectory:
    """The carts under given inputs, the same in continuous time on every grid (20 constant pieces), through soft contact."""
    model = build_model(
        CARTS.with_task(goal=(None,) * 6),
        ContactFormulation.SOFTPLUS,
        eps=1e-3,
        steps=steps,
        step=2.0 / steps,
        scheme=scheme,
    )
    for t in model.set_steps:
        phase = np.pi * (20 * t // steps) / 10
        model.variable_u[t, "u1"].fix(8.0 * np.sin(phase))
        model.variable_u[t, "u3"].fix(-8.0 * np.sin(phase))
    return _solved(model)


@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_smooth_contact_keeps_the_order(scheme: Scheme) -> None:
    truth = _pushed(320, Scheme.RADAU_IIA_2)
    assert truth.lam.max() > 2.0
    errors = []
    for steps in (20, 40):
        plan = _pushed(steps, scheme)
        errors.append(np.abs(plan.q - truth.q[:: 320 // steps]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(ORDERS[scheme], abs=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_the_method_keeps_the_true_law_at_every_stage(scheme: Scheme) -> None:
    """Checked by a step written apart from the model: the plan's inputs run through it give the plan."""
    scene = _coarse(50)
    kernel = load_kernel(scene)
    solution = (
        load_method("collocation")
        .open(scene, {"scheme": scheme.value})
        .solve(eps=None, warm_start=None, time_limit=600.0)
    )
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.size == solution.paper_size
    plan = solution.trajectory
    assert plan.lam.max() > 1.0
    assert defect(kernel, plan).max() < 1e-9
    q, _, made = rollout(kernel, plan.scheme, plan.start, plan.u, scene.task.step)
    assert made == scene.task.steps
    np.testing.assert_allclose(q, plan.q, atol=1e-8)
    assert 0.0 < solution.residuals["switch_error"] < 0.1
    assert solution.residuals["terminal_error"] < 1e-8


@pytest.mark.slow
def test_fifty_steps_of_radau_are_nearer_to_the_replay_than_five_hundred_of_euler() -> None:
    """The inputs are replayed as the stages had them: held over each step."""
    scene = _coarse(50)
    plan = (
        load_method("collocation")
        .open(scene, {})
        .solve(eps=None, warm_start=None, time_limit=600.0)
        .trajectory
    )
    assert plan is not None
    found = score(scene, plan, replay(scene, build_fmu(scene), plan))
    assert (found.value("replay_error") or 1.0) < 4e-3  # of the paper's 500 steps: 6.9e-3
    assert (found.value("defect") or 0.0) < 1e-9
    assert (found.value("law_error") or 0.0) < 1e-7
    assert found.value("physics") == 0.0


@pytest.mark.slow
def test_its_replay_error_is_that_of_the_scheme_where_nothing_switches() -> None:
    """The motion has no contact, so that the replay error is that of the scheme: order 3 beats order 2."""
    far = CARTS.with_task(
        steps=20,
        step=0.05,
        start=(2.0, 3.0, 4.0, 0.0, 0.0, 0.0),
        goal=(2.2, 3.0, 3.8, None, None, None),
    )
    errors = {}
    for scheme in (Scheme.IMPLICIT_MIDPOINT, Scheme.RADAU_IIA_2):
        plan = (
            load_method("collocation")
            .open(far, {"scheme": scheme.value})
            .solve(eps=None, warm_start=None, time_limit=600.0)
            .trajectory
        )
        assert plan.lam.max() == 0.0
        run = replay(far, build_fmu(far), plan)
        errors[scheme] = float(np.abs(run.q[run.knots] - plan.q).max())
    assert errors[Scheme.RADAU_IIA_2] < 2e-6  # measured: 9.8e-7 m
    assert errors[Scheme.IMPLICIT_MIDPOINT] > 2e-5  # measured: 6.0e-5 m


def test_the_cost_may_be_integrated() -> None:
    """wall_pendulum weighs its states: the sum over the starts of the steps is of order one, the quadrature is not."""
    scene = load_scene("wall_pendulum")
    models = {
        integrates: build_model(
            scene,
            ContactFormulation.SOFTPLUS,
            eps=1e-9,
            scheme=Scheme.RADAU_IIA_2,
            integrate_cost=integrates,
        )
        for integrates in (False, True)
    }
    for model in models.values():
        for data in model.variable_q.values():
            data.value = 0.1
        for data in model.variable_stage_q.values():
            data.value = 0.2
        for data in (*model.variable_v.values(), *model.variable_stage_v.values()):
            data.value = 0.0
    assert pyo.value(models[False].expression_cost) == pytest.approx(20 * 0.01)
    assert pyo.value(models[True].expression_cost) == pytest.approx(
        20 * (0.75 * 0.04 + 0.25 * 0.01)
    )


def test_a_plan_of_another_method_is_a_start_and_one_of_another_grid_is_not() -> None:
    scene = _coarse(50)
    model = build_model(scene, ContactFormulation.SOFTPLUS, eps=1e-5, scheme=Scheme.RADAU_IIA_2)
    run = load_kernel(scene).rollout(
        np.array(scene.task.start), np.full((50, 2), 1.0), scene.task.step
    )
    plan = Trajectory(t=np.arange(51) * 0.1, q=run.q, v=run.v, u=np.full((50, 2), 1.0), lam=run.lam)
    load_plan(model, plan)
    again = read_plan(model)
    np.testing.assert_array_equal(again.q, plan.q)
    np.testing.assert_array_equal(again.u, plan.u)
    first = tableau(Scheme.RADAU_IIA_2).c[0]
    assert pyo.value(model.variable_stage_q[7, "q1"]) == pytest.approx(
        plan.q[7, 0] + first * (plan.q[8, 0] - plan.q[7, 0])
    )
    shorter = Trajectory(
        t=plan.t[:-1], q=plan.q[:-1], v=plan.v[:-1], u=plan.u[:-1], lam=plan.lam[:-1]
    )
    with pytest.raises(TrajectoryError, match="steps"):
        load_plan(model, shorter)


@pytest.mark.parametrize(
    ("name", "word"),
    [("transport", "friction"), ("push_box", "friction"), ("damped_collision", "damped")],
)
def test_what_loses_the_order_is_refused_with_a_reason(name: str, word: str) -> None:
    with pytest.raises(ModelError, match=word):
        build_model(name, ContactFormulation.SOFTPLUS, eps=1e-3, scheme=Scheme.RADAU_IIA_2)
    if name != "damped_collision":
        assert word in str(load_method("collocation").accepts(load_scene(name)))


@pytest.mark.slow
def test_where_no_stage_has_modes_with_a_plan_the_relaxed_problem_is_asked_too():
    """A grid too coarse for a chain of carts: fixed modes switch the products off, and the relaxed problem has them again as rows."""
    scene = load_scene("cart_chain")
    coarse = scene.with_task(steps=62, step=scene.task.horizon / 62)
    found = solve_scene(
        coarse, "collocation", options={"scheme": "implicit_midpoint"}, time_limit=300.0
    )
    assert found.outcome in (Outcome.STALLED, Outcome.SOLVED)
    assert (found.trajectory is None) == (found.outcome is Outcome.STALLED)


METHODS = ("softplus_dc", "relaxed_lcp", "strict_lcp")
# Every method on what it finds hardest, one of them on all.
ALL_CASES = "relaxed_lcp"
HARDEST = ("horizon", "speed", "two seconds", "elsewhere, stiffer")
SCENE = load_scene("three_cart")


def asked(cases: Iterable[str]) -> list[tuple[str, str]]:
    return [
        (case, method)
        for case in cases
        for method in METHODS
        if method == ALL_CASES or case in HARDEST
    ]


def with_inputs(scene: Scene, *bounds: tuple[float, float]) -> Scene:
    inputs = (
        replace(item, lower=low, upper=high)
        for item, (low, high) in zip(scene.inputs, bounds, strict=True)
    )
    return replace(scene, inputs=tuple(inputs))


IMPOSSIBLE = {
    "horizon": SCENE.with_task(steps=50),
    "bounds": with_inputs(SCENE, (-0.3, 0.3), (-0.3, 0.3)).with_task(steps=100, step=0.02),
    # The right cart must come from the right to push the middle one to the left, but can only be
    # driven to the right.
    "no pull": with_inputs(SCENE, (-10.0, 10.0), (0.0, 10.0)).with_task(
        steps=100, step=0.02, goal=(2.0, 2.5, 4.5, 0.0, 0.0, 0.0)
    ),
    # The middle cart at 9 m/s with both neighbours at rest: Ipopt stays in restoration.
    "speed": SCENE.with_task(steps=100, step=0.02, goal=(2.5, 3.5, 4.5, 0.0, 9.0, 0.0)),
}
POSSIBLE = {
    "two seconds": SCENE.with_task(steps=100, step=0.02),
    "to the left": SCENE.with_task(steps=100, step=0.02, goal=(1.5, 2.5, 4.5, 0.0, 0.0, 0.0)),
    "touching at the goal": SCENE.with_task(
        steps=100, step=0.02, goal=(2.6, 3.1, 3.6, 0.0, 0.0, 0.0)
    ),
    "elsewhere, stiffer": SCENE.with_parameters(k=100.0).with_task(
        steps=100, step=0.02, start=(2.2, 3.0, 4.2, 0.0, 0.0, 0.0)
    ),
}


def solved(method: str, scene: Scene) -> Solution:
    return solve_scene(
        scene, method, eps=None if method == "strict_lcp" else 1e-3, time_limit=300.0
    )


@pytest.mark.slow
@pytest.mark.parametrize(("case", "method"), asked(IMPOSSIBLE))
def test_a_goal_out_of_reach_is_infeasible(case: str, method: str) -> None:
    solution = solved(method, IMPOSSIBLE[case])
    assert solution.outcome is Outcome.INFEASIBLE
    assert solution.trajectory is None
    assert solution.iterations < 1500, (
        "a third of the iterations it may spend on a feasible problem"
    )
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
    assert found.miss < 2e-3, (
        "softplus contact, sharp: the worst seen where the solves converge is 6e-4"
    )


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
def test_a_stubborn_infeasible_of_a_goal_within_reach_is_a_stall(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = CompiledModel.run

    def denied(self: CompiledModel, *args: object, **options: object):
        found = run(
            self, *args, **options
        )  # the search for the plan nearest to the goal has its answer
        return (
            found
            if self.model.component("objective_miss") is not None
            else replace(found, outcome=Outcome.INFEASIBLE)
        )

    monkeypatch.setattr(CompiledModel, "run", denied)
    solution = solved(method, POSSIBLE["two seconds"])
    assert solution.outcome is Outcome.STALLED
    assert "can be reached" in solution.message


def test_restoration_monitor_counts_consecutive_restoration() -> None:
    def line(restoration: bool) -> Iteration:
        numbers = dict.fromkeys(
            (
                "objective",
                "inf_pr",
                "inf_du",
                "mu",
                "step",
                "regularization",
                "alpha_du",
                "alpha_pr",
            ),
            0.0,
        )
        return Iteration(iteration=0, restoration=restoration, trials=1, **numbers)

    monitor = Monitor()
    assert all(monitor(line(True)) for _ in range(99))
    assert monitor(line(False))
    assert all(monitor(line(True)) for _ in range(99))
    assert not monitor.is_out
    assert not monitor(line(True))
    assert monitor.is_out
