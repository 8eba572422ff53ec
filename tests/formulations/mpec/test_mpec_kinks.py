"""Absolute values, minima and maxima: solved as pairs, handed back by the user's components, judged wherever the point is."""

import pyomo.environ as pyo
import pytest
from pyomo.core.expr.numeric_expr import MaxExpression, MinExpression
from pyomo.mpec import Complementarity, complements

from formulations.ipopt import ModelRefusedError
from formulations.mpec import certify, load, solve_mpec


def _model(**start: float) -> pyo.ConcreteModel:
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(initialize=start.get("x", 2.0)), pyo.Var(initialize=start.get("y", -1.0))
    return model


def _abs_on_its_kink(model):
    model.cost = pyo.Objective(expr=abs(model.x - 1) + 0.1 * (model.x - 3) ** 2 + model.y**2)
    return (1, 0), 0.4, 1  # slope of the square at 1: -0.4, weaker than the kink's 1


def _abs_beside_its_kink(model):
    model.cost = pyo.Objective(expr=abs(model.x - 1) + (model.x - 3) ** 2 + model.y**2)
    return (2.5, 0), 1.75, 0


def _largest_of_three(model):
    model.cost = pyo.Objective(expr=MaxExpression((model.x + model.y, -model.x, 1 - model.y)) + 0.05 * (model.x**2 + (model.y - 0.8) ** 2))
    # all three meet at x = -1/3, y = 2/3 with value 1/3; the square is too weak to leave
    return (-1 / 3, 2 / 3), 1 / 3 + 0.05 * (1 / 9 + (2 / 3 - 0.8) ** 2), 2


def _smallest_in_a_row(model):
    model.cost = pyo.Objective(expr=(model.x - 3) ** 2 + (model.y - 5) ** 2)
    model.row = pyo.Constraint(expr=MinExpression((model.x, model.y)) <= 1)  # one of the two gives way: the nearer one
    return (1, 5), 4, 0


def _maximised(model):
    model.cost = pyo.Objective(expr=-abs(model.x - 2) - model.y**2 + 0.5 * model.x, sense=pyo.maximize)
    return (2, 0), 1, 1


def _in_a_named_expression(model):
    model.gap = pyo.Expression(expr=abs(model.x) - 1)
    model.cost = pyo.Objective(expr=(model.x - 0.3) ** 2 + (model.y - 2) ** 2)
    model.first, model.second = pyo.Constraint(expr=model.gap >= 0), pyo.Constraint(expr=model.gap * model.y <= 7)
    return (1, 2), 0.49, 0


def _in_a_complementarity(model):
    model.cost = pyo.Objective(expr=(model.x - 2) ** 2 + (model.y - 1) ** 2)
    model.pair = Complementarity(expr=complements(abs(model.x) - 1 >= 0, model.y >= 0))
    return (2, 0), 1, 0


CASES = [
    _abs_on_its_kink, _abs_beside_its_kink, _largest_of_three, _smallest_in_a_row, _maximised, _in_a_named_expression, _in_a_complementarity,
]  # fmt: skip


@pytest.mark.parametrize("state", CASES, ids=lambda case: case.__name__.strip("_"))
def test_the_answer_is_that_of_the_closed_form(state):
    model = _model()
    point, value, kinks = state(model)
    before = [str(data.expr) for data in model.component_data_objects((pyo.Objective, pyo.Constraint))]
    result = solve_mpec(model)
    assert result.solved, result.message
    assert dict(zip((variable.name for variable in result.variables), result.x, strict=True)) == pytest.approx(
        {"x": point[0], "y": point[1]}, abs=1e-6
    )
    assert result.objective == pytest.approx(value, abs=1e-7)
    assert f"{kinks} of them on their kink" in result.message
    assert {id(row) for row in result.rows} == {
        id(row) for row in model.component_data_objects(pyo.Constraint, active=True, descend_into=False)
    }
    assert [pair.name for pair in result.pairs] == [data.name for data in model.component_data_objects(Complementarity)]
    assert [str(data.expr) for data in model.component_data_objects((pyo.Objective, pyo.Constraint))] == before
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
    assert (model.x.value, model.y.value, model.dual[model.row]) == pytest.approx((2, 1, 2), abs=1e-6)


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
