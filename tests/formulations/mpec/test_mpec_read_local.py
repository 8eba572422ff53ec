"""A model read to first order, by hand: each form of a complementarity, its signs, and every number of the certificate that follows; derivatives are Pyomo's, and a certificate whose derivatives contradict Pyomo's values does not hold."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.core.expr.calculus.derivatives import differentiate
from pyomo.mpec import Complementarity, complements

from formulations.certificate import plan as plans
from formulations.certificate.certificate import Multipliers
from formulations.certificate.local import (
    Derivatives,
    LocalModel,
    derivatives_of,
    number_of,
    read_local,
    values_set,
)
from formulations.ipopt import MissingValueError
from formulations.ipopt.problem import IpoptProblem
from formulations.mpec import Stationarity, certify
from formulations.solution import Outcome, Solution


def model(x: float, y: float) -> Any:
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=x), pyo.Var(initialize=y)
    return m


def slopes(m: Any, local: LocalModel, matrix: Any) -> list[float]:
    """Of the one row of a matrix, by x and y."""
    place = {id(variable): k for k, variable in enumerate(local.variables)}
    row = matrix.toarray().reshape(-1)
    return [
        float(row[place[id(variable)]]) if id(variable) in place else 0.0 for variable in (m.x, m.y)
    ]


def told(local: LocalModel) -> list[tuple]:
    """Its rows, then its variables: name, argument, value, lower and upper bound."""
    rows = local.rows
    names = [source.name for source in rows.sources]
    return list(
        zip(
            names,
            rows.arguments,
            rows.value.tolist(),
            rows.lower.tolist(),
            rows.upper.tolist(),
            strict=True,
        )
    )


FORMS = {
    "both from below": lambda m: complements(m.x >= 1, 3 * m.y >= 6),
    "above and below": lambda m: complements(2 * m.x <= 8, m.y >= 1),
    "below and above": lambda m: complements(m.x >= 1, m.y <= 4),
    "box": lambda m: complements(pyo.inequality(1, 2 * m.x, 5), 3 * m.y),
    "box last": lambda m: complements(3 * m.y, pyo.inequality(1, 2 * m.x, 5)),
}  # fmt: skip


@pytest.mark.parametrize(("form", "x", "y", "sides", "flips", "arguments", "first", "second"), [
    ("both from below", 3.0, 2.5, (2.0, 1.5), (1, 1), (0, 1), [1, 0], [0, 3]),
    ("above and below", 3.0, 2.5, (2.0, 1.5), (-1, 1), (0, 1), [-2, 0], [0, 1]),
    ("below and above", 3.0, 2.5, (2.0, 1.5), (1, -1), (0, 1), [1, 0], [0, -1]),
    ("below and above", 0.5, 4.25, (-0.5, -0.25), (1, -1), (0, 1), [1, 0], [0, -1]),
    ("box", 0.525, 1.0, (0.05, 3.0), (1, 1), (0, 1), [2, 0], [0, 3]),
    ("box", 0.525, -1.0, (0.05, -3.0), (1, 1), (0, 1), [2, 0], [0, 3]),
    ("box", 2.475, -1.0, (0.05, 3.0), (-1, -1), (0, 1), [-2, 0], [0, -3]),
    ("box", 2.475, 1.0, (0.05, -3.0), (-1, -1), (0, 1), [-2, 0], [0, -3]),
    ("box", 1.0, 0.05, (1.0, 0.15), (1, 1), (0, 1), [2, 0], [0, 3]),
    ("box", 1.0, -0.05, (3.0, 0.15), (-1, -1), (0, 1), [-2, 0], [0, -3]),
    ("box", 2.0, 0.05, (3.0, 0.15), (1, 1), (0, 1), [2, 0], [0, 3]),
    ("box last", 0.525, 1.0, (0.05, 3.0), (1, 1), (1, 0), [2, 0], [0, 3]),
    ("box last", 2.475, -1.0, (0.05, 3.0), (-1, -1), (1, 0), [-2, 0], [0, -3]),
    ("box", 0.25, 0.0, (-0.5, 0.0), (1, 1), (0, 1), [2, 0], [0, 3]),
    ("box", 3.0, 0.0, (-1.0, 0.0), (-1, -1), (0, 1), [-2, 0], [0, -3]),
])  # fmt: skip
def test_a_pair_has_its_sides_with_their_signs(form, x, y, sides, flips, arguments, first, second):
    m = model(x, y)
    m.pair = Complementarity(expr=FORMS[form](m))
    local = read_local(m, 0.1)
    (pair,) = local.pairs
    assert (pair.first, pair.second) == pytest.approx(sides)
    assert ((pair.first_flip, pair.second_flip), pair.arguments, pair.source.name) == (
        flips,
        arguments,
        "pair",
    )
    assert (slopes(m, local, local.first_jacobian), slopes(m, local, local.second_jacobian)) == (
        first,
        second,
    )
    assert local.rows.sources == local.variables


@pytest.mark.parametrize(("form", "y", "rows"), [
    ("box", 0.03, [(0, 2.0, 1.0, 5.0), (1, 0.09, 0.0, 0.0)]),
    ("box", -0.03, [(0, 2.0, 1.0, 5.0), (1, -0.09, 0.0, 0.0)]),
    ("box last", 0.03, [(0, 0.09, 0.0, 0.0), (1, 2.0, 1.0, 5.0)]),
    ("equal", 0.5, [(0, 2.0, 3.0, 3.0)]), ("equal last", 0.5, [(1, 2.0, 3.0, 3.0)]),
    ("empty", 0.03, [(0, 2.0, 3.0, 1.0), (1, 0.09, 0.0, 0.0)]),
])  # fmt: skip
def test_where_there_is_no_choice_rows_are_imposed(form: str, y: float, rows: list):
    m = model(1.0, y)
    m.p = pyo.Param(initialize=1.0, mutable=True)
    other = {
        "equal": lambda: complements(2 * m.x == 3, 3 * m.y),
        "equal last": lambda: complements(3 * m.y, 2 * m.x == 3),
        "empty": lambda: complements(pyo.inequality(3, 2 * m.x, m.p), 3 * m.y),
    }  # fmt: skip
    m.pair = Complementarity(expr=FORMS[form](m) if form in FORMS else other[form]())
    local = read_local(m, 0.1)
    assert local.pairs == ()
    assert told(local)[: len(rows)] == [
        ("pair", argument, pytest.approx(value), lower, upper)
        for argument, value, lower, upper in rows
    ]
    assert local.jacobian.shape[0] == len(rows)


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_every_number_of_a_certificate(sense):
    """At (2, 0.5): rows 3 x - y = 5.5 <= 4 and x + y >= 1, x <= 1.75, and the pair of 2 x >= 1, which is 3, and y - 0.25 >= 0."""
    m = model(2.0, 0.5)
    m.x.setub(1.75)
    m.much = pyo.Constraint(expr=3 * m.x - m.y <= 4)
    m.enough = pyo.Constraint(expr=m.x + m.y >= 1)
    m.pair = Complementarity(expr=complements(2 * m.x >= 1, m.y >= 0.25))
    m.cost = pyo.Objective(expr=m.x**2 + 4 * m.y, sense=sense)
    local = read_local(m, 1e-6)
    sign = 1.0 if sense == pyo.minimize else -1.0
    assert local.objective == 6.0
    gradient = {
        variable.name: value
        for variable, value in zip(local.variables, local.gradient.tolist(), strict=True)
    }
    assert gradient == {"x": 4.0 * sign, "y": 4.0 * sign}
    assert local.jacobian.shape[0] == 2
    assert told(local)[:2] == [
        ("much", None, 5.5, -math.inf, 4.0),
        ("enough", None, 2.5, 1.0, math.inf),
    ]
    assert sorted(told(local)[2:]) == [
        ("x", None, 2.0, -math.inf, 1.75),
        ("y", None, 0.5, -math.inf, math.inf),
    ]
    found = certify(m)
    assert (found.primal, found.primal_relative, found.worst) == (1.5, 0.375, "much")
    assert (found.complementarity, found.pairs, found.biactive, found.objective) == (
        0.25,
        1,
        0,
        6.0,
    )
    assert math.isnan(found.given_dual)
    m.much.deactivate()
    less = certify(m)
    assert (less.primal, less.primal_relative, less.worst) == (
        0.25,
        pytest.approx(0.25 / 1.75),
        "x",
    )
    m.x.setub(None)
    m.y.set_value(0.125)
    found = certify(m)
    assert (found.primal, found.worst, found.complementarity) == (0.125, "pair", 0.0)
    m.y.set_value(0.25)
    assert (certify(m).primal, certify(m).worst) == (0.0, "")


def origin(f1: float, f2: float) -> Any:
    """min f1 x + f2 y over 0 <= x complementary to y >= 0, at 0, with a row x + y = 0 more."""
    m = model(0.0, 0.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.row = pyo.Constraint(expr=m.x + m.y == 0)
    m.cost = pyo.Objective(expr=f1 * m.x + f2 * m.y)
    return m


@pytest.mark.parametrize(("row", "given", "left", "kind"), [
    (1.0, (1.0, 3.0), 0.0, Stationarity.STRONG), (3.0, (-1.0, 1.0), 0.0, Stationarity.STRONG),
    (1.0, (1.0, 2.0), 0.25, Stationarity.STRONG),
    (None, None, math.nan, Stationarity.STRONG), (1.0, None, 0.75, Stationarity.STRONG),
])  # fmt: skip
def test_multipliers_that_come_along_are_checked(
    row: float | None, given: tuple | None, left: float, kind: Stationarity
):
    m = origin(2.0, 4.0)
    multipliers = (
        None
        if row is None
        else Multipliers(rows={m.row: row}, pairs={} if given is None else {m.pair: given})
    )
    found = certify(m, multipliers)
    assert (found.stationarity, found.descent) == (kind, 0.0)
    assert found.given_dual == pytest.approx(left, nan_ok=True)
    assert found.holds == (not left > 0)
    assert found.dual <= 1e-10


def test_certify_solution_certifies_once(monkeypatch: pytest.MonkeyPatch):
    def certified(scene: Any, plan: Any) -> Any:
        return f"{scene}: {plan}"

    monkeypatch.setattr(plans, "certify_plan", certified)
    plain: Any = Solution(method="mpcc", outcome=Outcome.SOLVED, trajectory="plan")  # type: ignore[arg-type]
    scene: Any = "hill"
    assert plans.certify_solution(scene, plain).certificate == "hill: plan"
    known, lost = replace(plain, certificate="known"), replace(plain, trajectory=None)
    assert plans.certify_solution(scene, known) is known
    assert plans.certify_solution(scene, lost) is lost


@pytest.mark.parametrize(("x", "biactive"), [(0.9e-6, 1), (1.1e-6, 0), (-0.9e-6, 1)])
def test_a_side_within_a_millionth_is_active(x: float, biactive: int):
    m = model(x, 0.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.cost = pyo.Objective(expr=2 * m.x + 3 * m.y)
    found = certify(m)
    assert (found.biactive, found.pairs) == (biactive, 1)


def _model() -> pyo.ConcreteModel:
    """Repeated shapes, a rare one, data, constants, and a variable that is fixed."""
    model = pyo.ConcreteModel()
    model.x = pyo.Var(range(13), initialize=lambda _, k: 0.3 + 0.1 * k)
    model.p = pyo.Param(initialize=1.7, mutable=True)
    model.x[12].fix(0.4)
    model.row = pyo.Constraint(
        range(11),
        rule=lambda m, k: m.p * pyo.sin(m.x[k] * m.x[k + 1]) + 2 * m.x[k] - m.x[k] <= 1e2 * m.x[12],
    )
    model.flat = pyo.Constraint(range(9), rule=lambda m, k: m.x[k] - 3 * m.x[k + 2] <= m.p)
    model.rare = pyo.Constraint(expr=pyo.exp(model.x[0]) / model.x[3] <= 9)
    model.cost = pyo.Objective(expr=sum(model.x[k] ** 2 for k in range(12)))
    return model


def derivatives(expressions: Sequence[Any], goal: Any, sense: Any = pyo.minimize) -> Derivatives:
    valued = [(expression, number_of(expression)) for expression in expressions]
    return derivatives_of(valued, (goal, number_of(goal)), sense)


def _bodies(model: pyo.ConcreteModel) -> list:
    return [row.body for row in model.component_data_objects(pyo.Constraint)]


def test_derivatives_of_many_shapes_equal_pyomos():
    model = _model()
    bodies = [*_bodies(model), 5.0, model.x[12], 2 * model.p]
    found = derivatives(bodies, model.cost.expr, pyo.maximize)
    assert (found.notes, any(variable.fixed for variable in found.variables)) == ((), False)
    variables = list(found.variables)
    own = [differentiate(body, wrt_list=variables) for body in bodies[:-3]]
    np.testing.assert_allclose(found.jacobian.toarray()[:-3], own, rtol=1e-13, atol=1e-13)
    assert not found.jacobian[-3:].nnz
    own = differentiate(model.cost.expr, wrt_list=variables)
    np.testing.assert_allclose(-found.gradient, own, rtol=1e-13)
    assert found.scale == pytest.approx(2 * model.x[11].value)


def test_certify_without_derivatives_says_so():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=0.0)
    m.row = pyo.Constraint(expr=pyo.floor(m.x) <= 1.0)
    m.cost = pyo.Objective(expr=m.x**2)
    certificate = certify(m)
    assert (certificate.b_stationary, certificate.primal, certificate.pairs) == (None, 0.0, 0)
    (note,) = certificate.notes
    assert note.startswith("no derivatives: 'row' applies floor")
    assert note == certificate.obstacle


@pytest.mark.parametrize("target", [0, 1, 5, 10])
@pytest.mark.parametrize("by", [1e-4, -1e-4])
def test_derivatives_of_contradicted_row_are_unknown(target, by, monkeypatch):
    """A slope of one expression among eleven of its shape is off."""
    right = IpoptProblem.derivatives

    def off(self, x):
        gradient, entries = right(self, x)
        row, column = self.jacobianstructure()
        return gradient, entries * np.where((row == target) & (column == target), 1.0 + by, 1.0)

    monkeypatch.setattr(IpoptProblem, "derivatives", off)
    model = _model()
    found = derivatives(_bodies(model), model.cost.expr)
    assert found.notes == (
        "Pyomo's values contradict the derivatives of 1 expressions: please report this model",
    )
    assert np.isnan(found.gradient).all()
    certificate = certify(model)
    assert (found.notes[0] in certificate.notes, certificate.holds) == (True, False)


@pytest.mark.parametrize(("expression", "slope"), [
    (lambda x: pyo.sqrt(x + 0.3 + 1e-12), 5e5), (lambda x: 1e9 + pyo.sin(3e3 * x), None),
    (lambda x: pyo.exp(50 * x), None), (lambda x: 1e8 * x**3, None),
    (lambda x: 1 / (x + 0.3 + 1e-9), -1e18), (lambda x: pyo.exp(1e7 * (x + 0.3)), 1e7),
])  # fmt: skip
def test_derivatives_of_steep_expression_are_not_contradicted(expression, slope):
    """Beside a pole or the end of a domain, on a large constant, of short waves, in a large unit."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-0.3)
    found = derivatives([expression(m.x)], m.x)
    own = differentiate(expression(m.x), wrt=m.x)
    assert found.notes == ()
    assert found.jacobian.toarray()[0, 0] == pytest.approx(slope or own, rel=1e-6)


@pytest.mark.parametrize(("expression", "value", "slope"), [
    (lambda x: 3 * x + 2 - x, 1.4, 2.0), (lambda x: x**2, 0.09, -0.6),
    (lambda x: x**1.5, np.nan, np.nan), (lambda x: pyo.log(x), np.nan, -1 / 0.3),
    (lambda x: 1 / (x + 0.3), np.nan, np.nan), (lambda x: pyo.exp(1e4 * (x + 1.0)), np.nan, np.nan),
    (lambda x: pyo.sinh(x), np.sinh(-0.3), np.cosh(-0.3)),
], ids=["affine", "square", "complex", "logarithm", "pole", "overflow", "hyperbolic"])  # fmt: skip
def test_values_and_slopes_of_one_expression(expression, value, slope):
    """At x = -0.3."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-0.3)
    assert number_of(expression(m.x)) == pytest.approx(value, nan_ok=True)
    found = derivatives([expression(m.x)], 0.0).jacobian.toarray().ravel()
    if np.isfinite(slope):
        assert found == pytest.approx([slope])
    else:
        assert not np.isfinite(found).any()


def test_what_holds_no_variable_has_a_value_and_no_slope():
    m = pyo.ConcreteModel()
    m.x, m.p, m.y = pyo.Var(initialize=2.0), pyo.Param(initialize=3.0, mutable=True), pyo.Var()
    m.x.fix()
    assert [number_of(item) for item in (5, m.p, m.x * m.p)] == [5.0, 3.0, 6.0]
    assert np.isnan(number_of(m.y))
    assert np.isnan(number_of(m.y + 1))
    found = derivatives([5.0, m.p, m.p + 1, m.x * m.p + m.y], 0.0)
    assert (found.variables, found.jacobian.toarray().tolist()) == ((m.y,), [[0], [0], [0], [1]])


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


@pytest.mark.parametrize(("function", "slope"), [
    (lambda x, _: pyo.cosh(x), np.cosh(-0.3) - 0.3 * np.sinh(-0.3)),
    (lambda x, _: pyo.atanh(x), np.arctanh(-0.3) - 0.3 / (1 - 0.09)),
    (lambda x, p: x**p, 3 * 0.09),
], ids=["cosh", "atanh", "Param as exponent"])  # fmt: skip
def test_certify_rare_functions_holds_without_notes(function, slope):
    """Hyperbolic functions, and a negative base with a Param for an exponent."""
    model = _curve(function, -0.3)
    found = derivatives([model.row[0].body], 0.0)
    assert found.jacobian.toarray().ravel() == pytest.approx([slope], rel=1e-12)
    certificate = certify(model)
    assert (certificate.notes, certificate.holds) == ((), True)


def test_a_negative_base_with_a_broken_exponent_has_no_value():
    model = _curve(lambda x, p: x**p, -0.3)
    model.p.value = 1.5
    assert certify(model).notes == (
        "a function or derivative is not a finite number at this point",
    )


@pytest.mark.parametrize("where", ["row", "pair", "cost"])
def test_an_empty_expression_is_named(where):
    m = pyo.ConcreteModel()
    m.x, m.hole = pyo.Var(initialize=1.0), pyo.Expression()
    m.row = pyo.Constraint(expr=m.x + (m.hole if where == "row" else 0.0) <= 2)
    m.pair = Complementarity(
        expr=complements(m.x * (m.hole if where == "pair" else 1.0) >= 0, m.x >= 0)
    )
    m.cost = pyo.Objective(expr=m.x * (m.hole if where == "cost" else 1.0))
    with pytest.raises(
        MissingValueError, match=f"'{where}' needs the Expression 'hole', which is empty"
    ):
        certify(m)
