"""An infinite slope at the answer of an MPEC: named, and judged where it can be."""

from __future__ import annotations

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.mpec import certify, solve_mpec
from formulations.solution import Outcome


def _cheapest() -> pyo.ConcreteModel:
    """5 a^0.7 + b with a + b >= 3: all by b, as the first of a costs without end."""
    model = pyo.ConcreteModel()
    model.a = pyo.Var(bounds=(0.0, 5.0), initialize=1.0)
    model.b = pyo.Var(bounds=(0.0, 5.0), initialize=1.0)
    model.demand = pyo.Constraint(expr=model.a + model.b >= 3.0)
    model.cost = pyo.Objective(expr=5.0 * model.a**0.7 + model.b)
    return model


def test_infinite_cost_of_leaving_a_bound_is_no_way_down():
    result = solve_mpec(_cheapest())
    assert result.outcome is Outcome.SOLVED, result.message
    assert result.objective == pytest.approx(3.0, abs=1e-6)
    assert "the slope of objective 'cost' is infinite at a = 0" in result.message
    assert "B-stationary: no direction goes down" in result.message
    assert "nan" not in result.message


def test_other_variables_still_decide():
    """At b = 4 there is a way down, whatever the slope by a."""
    model = _cheapest()
    model.a.value, model.b.value = 0.0, 4.0
    certificate = certify(model)
    assert certificate.feasible
    assert certificate.b_stationary is False
    assert "infinite at a = 0" in certificate.sentence
    assert "a direction goes down" in certificate.sentence


def test_infinite_gain_at_a_bound_is_not_called_stationary():
    model = pyo.ConcreteModel()
    model.a = pyo.Var(bounds=(0.0, 5.0), initialize=0.0)
    model.gain = pyo.Objective(expr=pyo.sqrt(model.a), sense=pyo.maximize)
    certificate = certify(model)
    assert not certificate.holds
    assert certificate.b_stationary is not True
    assert "the slope of objective 'gain' is infinite at a = 0" in certificate.sentence
    assert "nan" not in certificate.sentence


def test_infinite_slope_of_a_constraint_is_named_and_nothing_claimed():
    model = pyo.ConcreteModel()
    model.a = pyo.Var(bounds=(0.0, 1.0), initialize=0.0)
    model.b = pyo.Var(initialize=1.0)
    model.root = pyo.Constraint(expr=model.b >= 1.0 + pyo.sqrt(model.a))
    model.cost = pyo.Objective(expr=model.b + model.a)
    certificate = certify(model)
    assert certificate.feasible, "there is no pair"
    assert "the slope of constraint 'root' is infinite at a = 0" in certificate.sentence
    assert "nan" not in certificate.sentence
    result = solve_mpec(model)
    assert "the slope of constraint 'root' is infinite at a = 0" in result.message
    assert "tolerances" not in result.message


def test_infinite_slope_of_a_pair_names_the_complementarity():
    model = pyo.ConcreteModel()
    model.a = pyo.Var(bounds=(0.0, 1.0), initialize=0.0)
    model.b = pyo.Var(bounds=(0.0, 1.0), initialize=0.5)
    model.touch = Complementarity(expr=complements(pyo.sqrt(model.a) >= 0.0, model.b >= 0.0))
    model.cost = pyo.Objective(expr=(model.b - 0.5) ** 2 + model.a)
    certificate = certify(model)
    assert "the slope of complementarity 'touch' is infinite at a = 0" in certificate.sentence
