"""What a certificate says of a point in words."""

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.mpec import certify
from tests.formulations.mpec.nearest import nearest


def at(x: float | None, y: float | None) -> str:
    """Of min (x - 1)^2 + (y - 2)^2, where x and y complement each other and x <= 3."""
    m = nearest(x, y)
    m.least = pyo.Constraint(expr=m.x <= 3)
    return certify(m).sentence


def test_a_stationary_point_has_a_class():
    assert [part for part in ("class S", ", B-stationary", "0 of 1 pairs") if part not in at(0.0, 2.0)] == []


@pytest.mark.parametrize(
    ("x", "y", "parts"),
    [(5.0, 0.0, ["not feasible", "most in least", "in no class"]), (0.5, 0.5, ["not feasible, so", "in no class"]), (None, None, ["in no class"])],
)  # fmt: skip
def test_a_point_that_is_not_feasible_is_of_no_class(x, y, parts):
    assert [part for part in parts if part not in at(x, y)] == []
    assert "B-stationar" not in at(x, y)


@pytest.mark.parametrize("x", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_no_point_is_in_a_range_that_holds_no_number(x):
    """1 <= x <= p at p = 0: x breaks one of the two by a half at least, wherever it is."""
    m = pyo.ConcreteModel()
    m.p = pyo.Param(initialize=0.0, mutable=True)
    m.x, m.y = pyo.Var(initialize=x), pyo.Var(initialize=2.0)
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 2) ** 2)
    m.pair = Complementarity(expr=complements(pyo.inequality(1, m.x, m.p), m.y))
    found = certify(m)
    assert not found.holds
    assert found.primal >= 0.5
    m.p.set_value(3.0)
    m.y.set_value(0.0)
    assert certify(m).primal == max(0.0, 1.0 - x)
