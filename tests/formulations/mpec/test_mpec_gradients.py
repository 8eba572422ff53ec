"""Derivatives evaluated together are Pyomo's own, and where they are not, Pyomo's are taken and the certificate says so."""

from contextlib import suppress

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.ipopt import MissingValueError
from formulations.ipopt.shapes import TermGroup
from formulations.mpec import certify
from formulations.mpec.certificate import derivatives
from formulations.mpec.certificate.derivatives import gradients_of, number_of, pyomo_gradient, values_set


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


@pytest.mark.parametrize("by", [1e-6, -1e-6])
@pytest.mark.parametrize("wrong", ["slopes", "values"])
def test_where_they_disagree_pyomos_are_taken(wrong, by, monkeypatch):
    right = getattr(TermGroup, wrong)
    monkeypatch.setattr(TermGroup, wrong, lambda self, x: right(self, x) * (1.0 + by))
    model = _model()
    expressions = _bodies(model)
    found = gradients_of(expressions, [number_of(expression) for expression in expressions])
    together, own = _dense(found, expressions)
    np.testing.assert_array_equal(together, own)
    assert "disagree with Pyomo's own" in found.notes[0]
    assert found.notes[0] in certify(model).notes


def test_what_pyomo_cannot_differentiate_is_compared_with_nothing(monkeypatch):
    """A derivative of Pyomo's that is no number contradicts none, and is told as what it is."""
    monkeypatch.setattr(
        derivatives, "pyomo_gradient", lambda expression: [(variable, np.nan) for variable, _ in pyomo_gradient(expression)]
    )
    expressions = _bodies(_model())
    found = gradients_of(expressions, [number_of(expression) for expression in expressions])
    assert [("no derivatives to compare" in note, "disagree" in note) for note in found.notes] == [(True, False)]


def _off_in(target: int, what: str, right):
    """One expression's share of what is evaluated together, a millionth off."""

    def found(self, x):
        numbers = np.array(right(self, x), dtype=float)
        rows = self.slope_entries[0] if what == "slopes" else self.rows
        numbers[np.asarray(rows) == target] *= 1.0 + 1e-6
        return numbers

    return found


@pytest.mark.parametrize(
    ("what", "target", "seen"),
    [("slopes", 0, True), ("slopes", 5, True), ("slopes", 10, True), ("slopes", 1, False), ("values", 1, True), ("values", 10, True)],
)
def test_first_middle_and_last_of_a_shape_are_differentiated_by_pyomo_too(what, target, seen, monkeypatch):
    """Of eleven rows; values are compared in each."""
    monkeypatch.setattr(TermGroup, what, _off_in(target, what, getattr(TermGroup, what)))
    model = _model()
    expressions = [model.row[k].body for k in range(11)]
    found = gradients_of(expressions, [number_of(expression) for expression in expressions])
    assert bool(found.notes) == seen


@pytest.mark.parametrize(
    ("expression", "value", "slope"),
    [
        (lambda x: 3 * x + 2 - x, 1.4, 2.0), (lambda x: x**2, 0.09, -0.6), (lambda x: x**1.5, np.nan, np.nan), (lambda x: pyo.log(x), np.nan, np.nan),
        (lambda x: 1 / (x + 0.3), np.nan, np.nan), (lambda x: pyo.exp(1e4 * (x + 1.0)), np.nan, np.nan), (lambda x: pyo.sinh(x), np.sinh(-0.3), np.cosh(-0.3)),
    ],
    ids=["affine", "square", "complex", "logarithm", "pole", "overflow", "hyperbolic"],
)  # fmt: skip
def test_values_and_slopes_of_one_expression(expression, value, slope):
    """At x = -0.3."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-0.3)
    assert number_of(expression(m.x)) == pytest.approx(value, nan_ok=True)
    [(variable, found)] = pyomo_gradient(expression(m.x))
    assert variable is m.x
    assert found == pytest.approx(slope, nan_ok=True)


def test_what_holds_no_variable_has_a_value_and_no_slope():
    m = pyo.ConcreteModel()
    m.x, m.p, m.y = pyo.Var(initialize=2.0), pyo.Param(initialize=3.0, mutable=True), pyo.Var()
    m.x.fix()
    assert [number_of(item) for item in (5, m.p, m.x * m.p)] == [5.0, 3.0, 6.0]
    assert np.isnan(number_of(m.y))
    assert np.isnan(number_of(m.y + 1))
    assert [pyomo_gradient(item) for item in (5.0, m.p, m.p + 1)] == [[], [], []]
    assert pyomo_gradient(m.x * m.p + m.y) == [(m.y, 1.0)]


def test_variables_are_set_for_the_time_being():
    m = pyo.ConcreteModel()
    m.x, m.y, m.z = pyo.Var(initialize=1.0, bounds=(0, 2)), pyo.Var(initialize=2.0), pyo.Var()
    m.x.stale, m.y.stale = False, True
    with suppress(ZeroDivisionError), values_set((m.x, m.y, m.z), (9.0, 8.0, 7.0)):
        assert (m.x.value, m.y.value, m.z.value) == (9.0, 8.0, 7.0)
        raise ZeroDivisionError
    assert (m.x.value, m.y.value, m.z.value, m.x.stale, m.y.stale) == (1.0, 2.0, None, False, True)


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
