"""Where a derivative is infinite or undefined at the answer, the message says of which function, and at which variable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import compile_model, solve
from formulations.ipopt.slopes import endless_slope
from formulations.solution import Outcome


def _model(build: Callable[[pyo.ConcreteModel], None]) -> pyo.ConcreteModel:
    model = pyo.ConcreteModel()
    model.u = pyo.Var(bounds=(0.0, 2.0), initialize=1.0)
    model.w = pyo.Var(initialize=2.0)
    build(model)
    return model


def _root_at_a_bound(model: pyo.ConcreteModel) -> None:
    model.effort = pyo.Objective(expr=3.0 * model.u**0.3 + (model.w - 1.0) ** 2)


def _root_of_a_difference(model: pyo.ConcreteModel) -> None:
    """Singular where no bound is, but a constraint: at w = 1.5."""
    model.floor = pyo.Constraint(expr=model.w >= 1.5)
    model.effort = pyo.Objective(expr=(model.w - 1.5) ** 0.4 + model.u)


def _root_in_a_constraint(model: pyo.ConcreteModel) -> None:
    model.rope = pyo.Constraint(expr=model.w >= 1.0 + pyo.sqrt(2.0 - model.u))
    model.effort = pyo.Objective(expr=model.w - 1e-3 * model.u)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (_root_at_a_bound, "the slope of objective 'effort' is infinite at u = 0"),
        (_root_of_a_difference, "the slope of objective 'effort' is infinite at w = 1.5"),
        (_root_in_a_constraint, "the slope of constraint 'rope' is infinite at u = 2"),
    ],
)
def test_solve_names_the_infinite_slope(build: Callable[[pyo.ConcreteModel], None], words: str):
    result = solve(compile_model(_model(build)))
    assert result.outcome is not Outcome.SOLVED
    assert words in result.message
    assert result.message.count("infinite") == 1


def test_solve_that_succeeds_says_nothing_of_slopes_elsewhere():
    """-sqrt(u) + u is least at 1/4, away from its infinite slope."""
    model = _model(lambda _: None)
    model.effort = pyo.Objective(expr=model.u - pyo.sqrt(model.u) + model.w**2)
    result = solve(compile_model(model))
    assert result.outcome is Outcome.SOLVED
    assert "slope" not in result.message


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ((0.0, 0.0), "constraint 'norm' has no derivative at w = 0"),
        ((0.0, 3e-7), "constraint 'norm' has no derivative at w = 0"),
        ((0.0, 0.3), ""),
        ((1e-6, 0.3), ""),
        ((float("nan"), 0.0), ""),
    ],
)
def test_slope_that_is_undefined_is_told_apart(point: tuple[float, float], words: str):
    """The distance sqrt(u^2 + w^2) has a kink at 0."""
    model = pyo.ConcreteModel()
    model.w, model.u = pyo.Var(), pyo.Var()
    model.norm = pyo.Constraint(expr=pyo.sqrt(model.w**2 + model.u**2) <= 1.0)
    problem = compile_model(model)
    order = [point[("u", "w").index(variable.name)] for variable in problem.variables]
    assert endless_slope(problem, np.array(order)) == words


def test_function_without_a_value_has_no_slope_to_speak_of():
    model = pyo.ConcreteModel()
    model.u = pyo.Var(bounds=(0.0, None))
    model.o = pyo.Objective(expr=pyo.log(model.u))
    assert endless_slope(compile_model(model), np.zeros(1)) == ""
