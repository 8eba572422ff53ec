"""Derivatives evaluated together are Pyomo's own, and where they are not, Pyomo's are taken and the certificate says so."""

from __future__ import annotations

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.ipopt import MissingValueError
from formulations.ipopt.shapes import TermGroup
from formulations.mpec import certify
from formulations.mpec.certificate.derivatives import gradients_of, number_of, pyomo_gradient


def _model() -> pyo.ConcreteModel:
    """Repeated shapes, a rare one, one that the compiler refuses, one without a derivative here, data, and a variable that is fixed."""
    model = pyo.ConcreteModel()
    model.x = pyo.Var(range(13), initialize=lambda _, k: 0.3 + 0.1 * k)
    model.p = pyo.Param(initialize=1.7, mutable=True)
    model.x[12].fix(0.4)
    model.row = pyo.Constraint(range(11), rule=lambda m, k: m.p * pyo.sin(m.x[k] * m.x[k + 1]) + 2 * m.x[k] - m.x[k] <= 1e2 * m.x[12])
    model.flat = pyo.Constraint(range(9), rule=lambda m, k: m.x[k] - 3 * m.x[k + 2] <= m.p)
    model.rare = pyo.Constraint(expr=pyo.exp(model.x[0]) / model.x[3] <= 9)
    model.kink = pyo.Constraint(expr=abs(model.x[1]) + model.x[2] ** 2 <= 9)
    model.cost = pyo.Objective(expr=sum(model.x[k] ** 2 for k in range(12)))
    return model


def _bodies(model: pyo.ConcreteModel) -> list:
    return [row.body for row in model.component_data_objects(pyo.Constraint)] + [model.cost.expr]


def _dense(found, expressions) -> tuple[np.ndarray, np.ndarray]:
    """(what was found, Pyomo's own), both by the found variables."""
    place = {id(variable): k for k, variable in enumerate(found.variables)}
    own = np.zeros(found.matrix.shape)
    for row, expression in enumerate(expressions):
        for variable, slope in pyomo_gradient(expression):
            own[row, place[id(variable)]] += slope
    return found.matrix.toarray(), own


def test_they_are_pyomos_own():
    model = _model()
    expressions = [*_bodies(model), pyo.sqrt(model.x[4] - model.x[4].value)]
    found = gradients_of(expressions, [number_of(expression) for expression in expressions])
    together, own = _dense(found, expressions)
    np.testing.assert_allclose(together, own, rtol=1e-13, atol=1e-13)
    assert found.notes == ()
    assert not any(variable.fixed for variable in found.variables)
    assert not np.isfinite(together[-1]).all()


def test_what_has_no_derivative_here_is_said_not_raised():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=0.0)
    m.row = pyo.Constraint(expr=pyo.floor(m.x) <= 1.0)
    m.cost = pyo.Objective(expr=m.x**2)
    certificate = certify(m)
    assert certificate.b_stationary is None
    assert certificate.notes == ("a function or derivative is not a finite number at this point",)


@pytest.mark.parametrize("wrong", ["slopes", "values"])
def test_where_they_disagree_pyomos_are_taken(wrong, monkeypatch):
    right = getattr(TermGroup, wrong)
    monkeypatch.setattr(TermGroup, wrong, lambda self, x: right(self, x) * (1.0 + 1e-6))
    model = _model()
    expressions = _bodies(model)
    found = gradients_of(expressions, [number_of(expression) for expression in expressions])
    together, own = _dense(found, expressions)
    np.testing.assert_array_equal(together, own)
    assert "disagree with Pyomo's own" in found.notes[0]
    assert found.notes[0] in certify(model).notes


def _curve(function, at: float) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(9), initialize=at)
    m.p = pyo.Param(initialize=2.0, mutable=True)
    m.row = pyo.Constraint(range(9), rule=lambda m, k: function(m.x[k], m.p) * m.x[k] <= 9.0)
    m.cost = pyo.Objective(expr=sum((m.x[k] - at) ** 2 for k in range(9)))
    return m


@pytest.mark.parametrize(
    ("function", "slope"),
    [
        (lambda x, _: pyo.cosh(x), np.cosh(-0.3) - 0.3 * np.sinh(-0.3)),
        (lambda x, _: pyo.atanh(x), np.arctanh(-0.3) - 0.3 / (1 - 0.09)),
        (lambda x, p: x**p, 3 * 0.09),
    ],
    ids=["cosh", "atanh", "Param as exponent"],
)
def test_what_pyomos_reverse_mode_does_not_know(function, slope):
    """Hyperbolic functions, and a negative base with a Param for an exponent: right, and no word of a disagreement."""
    model = _curve(function, -0.3)
    [(_, own)] = pyomo_gradient(model.row[0].body)
    assert own == pytest.approx(slope, rel=1e-12)
    certificate = certify(model)
    assert certificate.notes == ()
    assert certificate.holds


def test_a_negative_base_with_a_broken_exponent_has_no_value():
    model = _curve(lambda x, p: x**p, -0.3)
    model.p.value = 1.5
    assert certify(model).notes == ("a function or derivative is not a finite number at this point",)


@pytest.mark.parametrize("where", ["row", "pair", "cost"])
def test_an_empty_expression_is_named(where):
    m = pyo.ConcreteModel()
    m.x, m.hole = pyo.Var(initialize=1.0), pyo.Expression()
    m.row = pyo.Constraint(expr=m.x + (m.hole if where == "row" else 0.0) <= 2)
    m.pair = Complementarity(expr=complements(m.x * (m.hole if where == "pair" else 1.0) >= 0, m.x >= 0))
    m.cost = pyo.Objective(expr=m.x * (m.hole if where == "cost" else 1.0))
    with pytest.raises(MissingValueError, match=f"'{where}' needs the Expression 'hole', which is empty"):
        certify(m)
