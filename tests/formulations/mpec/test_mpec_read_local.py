"""A model read to first order, by hand: each form of a complementarity, its signs, and every number of the certificate that follows."""

import math
from dataclasses import replace
from typing import Any

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.mpec import Stationarity, certify
from formulations.mpec.certificate import plan as plans
from formulations.mpec.certificate.certificate import Multipliers
from formulations.mpec.certificate.derivatives import LocalModel, read_local
from formulations.solution import FrontPoint, Outcome, Solution


def model(x: float, y: float) -> Any:
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=x), pyo.Var(initialize=y)
    return m


def slopes(m: Any, local: LocalModel, matrix: Any) -> list[float]:
    """Of the one row of a matrix, by x and y."""
    place = {id(variable): k for k, variable in enumerate(local.variables)}
    row = matrix.toarray().reshape(-1)
    return [float(row[place[id(variable)]]) if id(variable) in place else 0.0 for variable in (m.x, m.y)]


FORMS = {
    "both from below": lambda m: complements(m.x >= 1, 3 * m.y >= 6),
    "above and below": lambda m: complements(2 * m.x <= 8, m.y >= 1),
    "below and above": lambda m: complements(m.x >= 1, m.y <= 4),
    "box": lambda m: complements(pyo.inequality(1, 2 * m.x, 5), 3 * m.y),
    "box last": lambda m: complements(3 * m.y, pyo.inequality(1, 2 * m.x, 5)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("form", "x", "y", "sides", "flips", "arguments", "first", "second"),
    [
        ("both from below", 3.0, 2.5, (2.0, 1.5), (1, 1), (0, 1), [1, 0], [0, 3]), ("above and below", 3.0, 2.5, (2.0, 1.5), (-1, 1), (0, 1), [-2, 0], [0, 1]),
        ("below and above", 3.0, 2.5, (2.0, 1.5), (1, -1), (0, 1), [1, 0], [0, -1]), ("below and above", 0.5, 4.25, (-0.5, -0.25), (1, -1), (0, 1), [1, 0], [0, -1]),
        ("box", 0.525, 1.0, (0.05, 3.0), (1, 1), (0, 1), [2, 0], [0, 3]), ("box", 0.525, -1.0, (0.05, -3.0), (1, 1), (0, 1), [2, 0], [0, 3]),
        ("box", 2.475, -1.0, (0.05, 3.0), (-1, -1), (0, 1), [-2, 0], [0, -3]), ("box", 2.475, 1.0, (0.05, -3.0), (-1, -1), (0, 1), [-2, 0], [0, -3]),
        ("box", 1.0, 0.05, (1.0, 0.15), (1, 1), (0, 1), [2, 0], [0, 3]), ("box", 1.0, -0.05, (3.0, 0.15), (-1, -1), (0, 1), [-2, 0], [0, -3]),
        ("box", 2.0, 0.05, (3.0, 0.15), (1, 1), (0, 1), [2, 0], [0, 3]), ("box last", 0.525, 1.0, (0.05, 3.0), (1, 1), (1, 0), [2, 0], [0, 3]),
        ("box last", 2.475, -1.0, (0.05, 3.0), (-1, -1), (1, 0), [-2, 0], [0, -3]), ("box", 0.25, 0.0, (-0.5, 0.0), (1, 1), (0, 1), [2, 0], [0, 3]),
        ("box", 3.0, 0.0, (-1.0, 0.0), (-1, -1), (0, 1), [-2, 0], [0, -3]),
    ],
)  # fmt: skip
def test_a_pair_has_its_sides_with_their_signs(form, x, y, sides, flips, arguments, first, second):
    m = model(x, y)
    m.pair = Complementarity(expr=FORMS[form](m))
    local = read_local(m, 0.1)
    (pair,) = local.pairs
    assert (pair.first, pair.second) == pytest.approx(sides)
    assert ((pair.first_flip, pair.second_flip), pair.arguments, pair.source.name) == (flips, arguments, "pair")
    assert (slopes(m, local, local.first_jacobian), slopes(m, local, local.second_jacobian)) == (first, second)
    assert local.rows == ()


@pytest.mark.parametrize(
    ("form", "y", "rows"),
    [
        ("box", 0.03, [(0, 2.0, 1.0, 5.0), (1, 0.09, 0.0, 0.0)]), ("box", -0.03, [(0, 2.0, 1.0, 5.0), (1, -0.09, 0.0, 0.0)]), ("box last", 0.03, [(0, 0.09, 0.0, 0.0), (1, 2.0, 1.0, 5.0)]),
        ("equal", 0.5, [(0, 2.0, 3.0, 3.0)]), ("equal last", 0.5, [(1, 2.0, 3.0, 3.0)]), ("empty", 0.03, [(0, 2.0, 3.0, 1.0), (1, 0.09, 0.0, 0.0)]),
    ],
)  # fmt: skip
def test_where_there_is_no_choice_rows_are_imposed(form: str, y: float, rows: list):
    m = model(1.0, y)
    m.p = pyo.Param(initialize=1.0, mutable=True)
    other = {
        "equal": lambda: complements(2 * m.x == 3, 3 * m.y), "equal last": lambda: complements(3 * m.y, 2 * m.x == 3),
        "empty": lambda: complements(pyo.inequality(3, 2 * m.x, m.p), 3 * m.y),
    }  # fmt: skip
    m.pair = Complementarity(expr=FORMS[form](m) if form in FORMS else other[form]())
    local = read_local(m, 0.1)
    assert local.pairs == ()
    assert [(row.argument, pytest.approx(row.value), row.lower, row.upper) for row in local.rows] == rows
    assert {row.source.name for row in local.rows} == {"pair"}


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
    gradient = {variable.name: value for variable, value in zip(local.variables, local.gradient.tolist(), strict=True)}
    assert gradient == {"x": 4.0 * sign, "y": 4.0 * sign}
    assert [(row.source.name, row.value, row.lower, row.upper) for row in local.rows] == [
        ("much", 5.5, -math.inf, 4.0),
        ("enough", 2.5, 1.0, math.inf),
    ]
    assert {row.source.name: (row.value, row.lower, row.upper) for row in local.bounds} == {
        "x": (2.0, -math.inf, 1.75),
        "y": (0.5, -math.inf, math.inf),
    }
    found = certify(m)
    assert (found.primal, found.primal_relative, found.worst) == (1.5, 0.375, "much")
    assert (found.complementarity, found.product, found.pairs, found.biactive, found.objective) == (0.25, 0.75, 1, 0, 6.0)
    assert math.isnan(found.given_dual)
    m.much.deactivate()
    less = certify(m)
    assert (less.primal, less.primal_relative, less.worst) == (0.25, pytest.approx(0.25 / 1.75), "x")
    m.x.setub(None)
    m.y.set_value(0.125)
    assert (certify(m).primal, certify(m).worst, certify(m).complementarity, certify(m).product) == (0.125, "pair", 0.0, 0.375)
    m.y.set_value(0.25)
    assert (certify(m).primal, certify(m).worst) == (0.0, "")


def origin(f1: float, f2: float) -> Any:
    """min f1 x + f2 y over 0 <= x complementary to y >= 0, at 0, with a row x + y = 0 more."""
    m = model(0.0, 0.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.row = pyo.Constraint(expr=m.x + m.y == 0)
    m.cost = pyo.Objective(expr=f1 * m.x + f2 * m.y)
    return m


@pytest.mark.parametrize(
    ("row", "given", "left", "kind"),
    [
        (1.0, (1.0, 3.0), 0.0, Stationarity.STRONG), (3.0, (-1.0, 1.0), 0.0, Stationarity.STRONG), (1.0, (1.0, 2.0), 0.25, Stationarity.STRONG),
        (None, None, math.nan, Stationarity.STRONG), (1.0, None, 0.75, Stationarity.STRONG),
    ],
)  # fmt: skip
def test_multipliers_that_come_along_are_checked(row: float | None, given: tuple | None, left: float, kind: Stationarity):
    m = origin(2.0, 4.0)
    multipliers = None if row is None else Multipliers(rows={m.row: row}, pairs={} if given is None else {m.pair: given})  # type: ignore[arg-type]
    found = certify(m, multipliers)
    assert (found.stationarity, found.descent) == (kind, 0.0)
    assert found.given_dual == pytest.approx(left, nan_ok=True)
    assert found.holds == (not left > 0)
    if row == 1.0 and given == (1.0, 3.0):
        assert (found.dual, found.unique) == (0.0, False)
        assert math.isnan(found.least)


def test_a_plan_is_certified_with_those_of_its_front(monkeypatch: pytest.MonkeyPatch):
    """The judge is asked with the ball of each plan, once; of a front the first point's certificate is the plan's."""
    asked: list[tuple[str, float]] = []

    class Judge:
        def __init__(self, scene: Any) -> None:
            self.scene = scene

        def certify(self, plan: Any, *, goal_tolerance: float) -> Any:
            asked.append((plan, goal_tolerance))
            return f"{self.scene}: {plan} within {goal_tolerance}"

    monkeypatch.setattr(plans, "PlanJudge", Judge)
    plain: Any = Solution(method="mpcc", outcome=Outcome.SOLVED, trajectory="plan")  # type: ignore[arg-type]
    scene: Any = "hill"
    assert plans.certify_solution(scene, plain).certificate == "hill: plan within 0.0"
    ball = replace(plain, options={"goal_tolerance": 0.5})
    assert plans.certify_solution(scene, ball).certificate == "hill: plan within 0.5"
    known = replace(plain, certificate="known")
    assert plans.certify_solution(scene, known) is known
    points = tuple(
        FrontPoint(tolerance=0.1, solution=replace(plain, trajectory=name, options={"goal_tolerance": ball}))
        for name, ball in (("near", 0.1), ("far", 0.2))
    )
    asked.clear()
    found = plans.certify_solution(scene, replace(plain, front=points))
    assert asked == [("near", 0.1), ("far", 0.2)]
    assert found.certificate == "hill: near within 0.1"
    assert [point.solution.certificate for point in found.front] == ["hill: near within 0.1", "hill: far within 0.2"]
    lost = plans.certify_solution(scene, replace(plain, trajectory=None, front=points))
    assert (lost.certificate, len(lost.front)) == (None, 2)
    assert plans.certify_plan(scene, "plan") == "hill: plan within 0.0"  # type: ignore[arg-type, comparison-overlap]
    assert plans.certify_plan(scene, "plan", goal_tolerance=2.0) == "hill: plan within 2.0"  # type: ignore[arg-type, comparison-overlap]


@pytest.mark.parametrize(("x", "biactive"), [(0.9e-6, 1), (1.1e-6, 0), (-0.9e-6, 1)])
def test_a_side_within_a_millionth_is_active(x: float, biactive: int):
    m = model(x, 0.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.cost = pyo.Objective(expr=2 * m.x + 3 * m.y)
    found = certify(m)
    assert (found.biactive, found.pairs) == (biactive, 1)
