"""Certificates of scene plans, and of points whose multipliers are known: right plans are confirmed, wrong ones found out. Absolute values, minima and maxima: solved as pairs, handed back by the user's components, judged wherever the point is."""

import math
from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest
import scipy.sparse as sparse
from pyomo.core.expr.numeric_expr import MaxExpression, MinExpression
from pyomo.mpec import Complementarity, complements

from formulations.certificate.local import read_local
from formulations.certificate.stationarity import active_set, balance
from formulations.ipopt import ModelRefusedError
from formulations.mpec import (
    Certificate,
    Stationarity,
    certify,
    certify_plan,
    certify_solution,
    load,
    solve_mpec,
)
from formulations.pipelines import solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.build import build_model, load_plan
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory

SCENE = load_scene("three_cart").with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)


def solved(method: str, **options) -> Solution:
    return solve_scene(
        SCENE, method, eps=1e-2 if method == "relaxed_lcp" else None, options=options
    )


def plan_of(solution: Solution) -> Trajectory:
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.trajectory is not None
    return solution.trajectory


@pytest.fixture(scope="module")
def best() -> Solution:
    return solved("mpcc")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["mpcc", "strict_lcp"])
def test_exact_plans_are_certified(method: str) -> None:
    solution = solved(method)
    certificate = certify_plan(SCENE, plan_of(solution))
    assert certificate.holds, certificate.sentence
    assert certificate.stationarity is Stationarity.STRONG
    assert certificate.objective == pytest.approx(solution.cost, rel=1e-12)
    assert certificate.primal <= 1e-9
    assert certificate.complementarity <= 1e-9
    assert certificate.pairs == SCENE.nc * SCENE.task.steps


@pytest.mark.slow
def test_multipliers_agree_with_those_of_the_solver() -> None:
    """Two codes: a banded KKT system of the method, a linear program on the Pyomo model."""
    scene = load_scene("three_cart")
    solution = solve_scene(scene, "mpcc")
    certificate = certify_plan(scene, plan_of(solution))
    assert certificate.holds, certificate.sentence
    assert certificate.biactive == solution.residuals["biactive_pairs"] > 0
    assert certificate.strong is (solution.residuals["least_biactive_multiplier"] >= 0.0) is True
    model = build_model(scene)
    load_plan(model, plan_of(solution))
    local = read_local(model, 1e-6)
    active = active_set(local, 1e-6)
    y = balance(active, local.gradient, 1e-5).y
    # A force's own bound is the same condition as its side: their multipliers count together.
    length = sparse.linalg.norm(active.normals, axis=1)
    unit = sparse.diags(1.0 / length) @ active.normals
    sides = [*active.first, *active.second]
    alike = (unit @ unit[sides].T).toarray() > 1.0 - 1e-12
    found = (y * length) @ alike / length[sides] / active.sizes[sides]
    assert found.min() == pytest.approx(solution.residuals["least_biactive_multiplier"], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("error", [1e-6, -1e-6])
def test_a_force_that_is_off_is_found(best: Solution, error: float) -> None:
    plan = plan_of(best)
    closed = int(np.flatnonzero(plan.lam[:, 0] > 0)[3])
    for step in (closed, 2):
        lam = plan.lam.copy()
        lam[step, 0] += error
        certificate = certify_plan(SCENE, replace(plan, lam=lam))
        assert not certificate.holds
        assert not certificate.feasible
        assert max(certificate.primal, certificate.complementarity) == pytest.approx(1e-6, rel=1e-2)


def test_a_contact_moved_by_a_step_is_found(best: Solution) -> None:
    plan = plan_of(best)
    certificate = certify_plan(SCENE, replace(plan, lam=np.roll(plan.lam, 1, axis=0)))
    assert not certificate.holds
    assert certificate.primal > 1e-3
    assert certificate.worst.startswith(
        ("complementarity_contact", "constraint_velocity_step", "variable_lam")
    )


def test_a_dearer_plan_of_the_same_task_is_not_stationary(best: Solution) -> None:
    """Feasible, complementary, but not optimal: more than needed is pushed while nothing touches."""
    from models.codegen.kernel import load_kernel

    plan, task = plan_of(best), SCENE.task
    u = plan.u.copy()
    u[-2, 1] += 1e-3
    rollout = load_kernel(SCENE).rollout(np.array(task.start), u, task.step)
    other = replace(SCENE, task=replace(task, goal=(*rollout.q[-1], *rollout.v[-1])))
    certificate = certify_plan(
        other, Trajectory(t=plan.t, q=rollout.q, v=rollout.v, u=u, lam=rollout.lam)
    )
    assert certificate.feasible
    assert certificate.stationarity is Stationarity.NONE
    assert certificate.b_stationary is False
    assert certificate.dual > 1e-5


@pytest.mark.slow
def test_a_relaxed_plan_is_not_complementary() -> None:
    certificate = certify_plan(SCENE, plan_of(solved("relaxed_lcp")))
    assert not certificate.feasible
    assert certificate.complementarity == pytest.approx(math.sqrt(1e-2), rel=0.5)


def test_without_a_plan_there_is_nothing_to_certify() -> None:
    nothing = Solution(method="mpcc", outcome=Outcome.INFEASIBLE)
    assert certify_solution(SCENE, nothing) == nothing


def test_a_plan_of_another_grid_is_refused(best: Solution) -> None:
    with pytest.raises(TrajectoryError, match="100 steps"):
        certify_plan(SCENE.with_task(steps=50), plan_of(best))


def two_sided(x_slope: float, y_slope: float) -> Certificate:
    """min x_slope x + y_slope y + x^2 + y^2 with 0 <= x complementary to 0 <= y, at (0, 0): the slopes are the multipliers."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(bounds=(0, None), initialize=0.0), pyo.Var(bounds=(0, None), initialize=0.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.cost = pyo.Objective(expr=x_slope * m.x + y_slope * m.y + m.x**2 + m.y**2)
    return certify(m)


@pytest.mark.parametrize(
    "slopes", [(1.0, 2.0), (0.0, -1.0), (-1.0, -2.0), (-1.0, 2.0), (2.0, -1.0)]
)
def test_certify_bounds_of_a_pair_do_not_hide_signs(slopes: tuple[float, float]) -> None:
    """x >= 0 is a bound of the variable and a side of the pair: the same condition twice."""
    certificate = two_sided(*slopes)
    strong = min(slopes) >= 0.0
    assert (certificate.strong, certificate.b_stationary) == (strong, strong)
    steepest = min(slopes) / max(1.0, *(abs(slope) for slope in slopes))
    assert certificate.descent == pytest.approx(0.0 if strong else steepest)
    assert strong or f"has the multiplier {min(slopes):.3g}" in certificate.obstacle


def at_the_origin(first, second, cost) -> Certificate:
    """Of minimise cost(x, y) with two rows, at (0, 0)."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=0.0), pyo.Var(initialize=0.0)
    m.first, m.second = pyo.Constraint(expr=first(m.x, m.y)), pyo.Constraint(expr=second(m.x, m.y))
    m.cost = pyo.Objective(expr=cost(m.x, m.y))
    return certify(m)


def test_several_gentle_slopes_are_a_steep_one_together() -> None:
    """Both multipliers are -1.

    Along either edge the cost falls by 1e-6 only, along (1, 0), which leaves both rows, by 2: its
    largest derivative.
    """
    certificate = at_the_origin(
        lambda x, y: x >= 0, lambda x, y: x + 1e-6 * y >= 0, lambda x, y: -(2 * x + 1e-6 * y)
    )
    assert certificate.descent == pytest.approx(-1.0, rel=1e-3)
    assert certificate.b_stationary is False
    assert not certificate.holds


@pytest.mark.parametrize("left", [2e-5, 1e-3, 1.0])
def test_multipliers_of_nearly_dependent_gradients_may_be_large(left: float) -> None:
    """(1, 0) and (1, 1e-7) make up (1, left) with multipliers of left / 1e-7."""
    certificate = at_the_origin(
        lambda x, y: x == 0, lambda x, y: x + 1e-7 * y == 0, lambda x, y: x + left * y
    )
    assert certificate.stationarity is Stationarity.STRONG
    assert certificate.holds


def _model(**start: float) -> pyo.ConcreteModel:
    model = pyo.ConcreteModel()
    model.x, model.y = (
        pyo.Var(initialize=start.get("x", 2.0)),
        pyo.Var(initialize=start.get("y", -1.0)),
    )
    return model


def _abs_on_its_kink(model):
    model.cost = pyo.Objective(expr=abs(model.x - 1) + 0.1 * (model.x - 3) ** 2 + model.y**2)
    return (1, 0), 0.4, 1  # slope of the square at 1: -0.4, weaker than the kink's 1


def _abs_beside_its_kink(model):
    model.cost = pyo.Objective(expr=abs(model.x - 1) + (model.x - 3) ** 2 + model.y**2)
    return (2.5, 0), 1.75, 0


def _largest_of_three(model):
    model.cost = pyo.Objective(
        expr=MaxExpression((model.x + model.y, -model.x, 1 - model.y))
        + 0.05 * (model.x**2 + (model.y - 0.8) ** 2)
    )
    # all three meet at x = -1/3, y = 2/3 with value 1/3; the square is too weak to leave
    return (-1 / 3, 2 / 3), 1 / 3 + 0.05 * (1 / 9 + (2 / 3 - 0.8) ** 2), 2


def _smallest_in_a_row(model):
    model.cost = pyo.Objective(expr=(model.x - 3) ** 2 + (model.y - 5) ** 2)
    model.row = pyo.Constraint(
        expr=MinExpression((model.x, model.y)) <= 1
    )  # one of the two gives way: the nearer one
    return (1, 5), 4, 0


def _maximised(model):
    model.cost = pyo.Objective(
        expr=-abs(model.x - 2) - model.y**2 + 0.5 * model.x, sense=pyo.maximize
    )
    return (2, 0), 1, 1


def _in_a_named_expression(model):
    model.gap = pyo.Expression(expr=abs(model.x) - 1)
    model.cost = pyo.Objective(expr=(model.x - 0.3) ** 2 + (model.y - 2) ** 2)
    model.first, model.second = (
        pyo.Constraint(expr=model.gap >= 0),
        pyo.Constraint(expr=model.gap * model.y <= 7),
    )
    return (1, 2), 0.49, 0


def _in_a_complementarity(model):
    model.cost = pyo.Objective(expr=(model.x - 2) ** 2 + (model.y - 1) ** 2)
    model.pair = Complementarity(expr=complements(abs(model.x) - 1 >= 0, model.y >= 0))
    return (2, 0), 1, 0


CASES = [
    _abs_on_its_kink, _abs_beside_its_kink, _largest_of_three, _smallest_in_a_row, _maximised,
    _in_a_named_expression, _in_a_complementarity,
]  # fmt: skip


@pytest.mark.parametrize("state", CASES, ids=lambda case: case.__name__.strip("_"))
def test_the_answer_is_that_of_the_closed_form(state):
    model = _model()
    point, value, kinks = state(model)
    before = [
        str(data.expr) for data in model.component_data_objects((pyo.Objective, pyo.Constraint))
    ]
    result = solve_mpec(model)
    assert result.solved, result.message
    assert dict(
        zip((variable.name for variable in result.variables), result.x, strict=True)
    ) == pytest.approx({"x": point[0], "y": point[1]}, abs=1e-6)
    assert result.objective == pytest.approx(value, abs=1e-7)
    assert f"{kinks} of them on their kink" in result.message
    assert {id(row) for row in result.rows} == {
        id(row)
        for row in model.component_data_objects(pyo.Constraint, active=True, descend_into=False)
    }
    assert [pair.name for pair in result.pairs] == [
        data.name for data in model.component_data_objects(Complementarity)
    ]
    assert [
        str(data.expr) for data in model.component_data_objects((pyo.Objective, pyo.Constraint))
    ] == before
    load(result)
    assert certify(model).holds


def test_a_point_that_is_not_stationary_is_told_from_one_that_is():
    model = _model()
    _abs_on_its_kink(model)
    for x, holds in ((1.0, True), (1.1, False), (0.9, False)):
        model.x.set_value(x)
        model.y.set_value(0.0)
        found = certify(model)
        assert found.holds is holds, x
        assert "written as pairs" in found.notes[-1]


def test_multipliers_are_those_of_the_smooth_problem():
    model = _model(x=4.0)
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + model.y**2)
    model.row = pyo.Constraint(expr=abs(model.x) + model.y >= 3)
    model.dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    pyo.SolverFactory("mpec_ipopt").solve(model)
    # x + y = 3: x = 2, y = 1, multiplier 2
    assert (model.x.value, model.y.value, model.dual[model.row]) == pytest.approx(
        (2, 1, 2), abs=1e-6
    )


def test_what_is_fixed_or_inactive_is_no_kink_and_ipopt_alone_names_the_way():
    model = _model()
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + model.y**2)
    model.asleep = pyo.Constraint(expr=abs(model.x) <= 0.5)
    model.asleep.deactivate()
    model.z = pyo.Var(initialize=-3)
    model.z.fix()
    model.row = pyo.Constraint(expr=model.x + abs(model.z) >= 1)
    result = solve_mpec(model)
    assert result.solved
    assert "kink" not in result.message
    model.asleep.activate()
    with pytest.raises(ModelRefusedError, match=r"asleep.*abs.*mpec_ipopt"):
        pyo.SolverFactory("touchstone_ipopt").solve(model)


def test_a_model_that_has_a_component_of_the_blocks_name():
    model = _model()
    model.kinks = pyo.Param(initialize=1.0, mutable=True)
    model.cost = pyo.Objective(expr=abs(model.x - model.kinks) + model.y**2)
    result = solve_mpec(model)
    assert (result.solved, result.objective) == (True, pytest.approx(0, abs=1e-8))
