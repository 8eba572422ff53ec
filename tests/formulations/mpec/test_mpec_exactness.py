"""Points that satisfy every residual to tolerance, and only because complementarity is not exact, are no solutions."""

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.mpec import certify, solve_mpec
from formulations.solution import Outcome

# x and y must not both be 0 in any of them, as far as the other row goes: none has a solution.
IMPOSSIBLE = {
    "product": lambda m: m.x * m.y >= 1, "small product": lambda m: m.x * m.y >= 1e-4, "quadratic": lambda m: m.x**2 * m.y >= 1,
    "root": lambda m: pyo.sqrt(m.x) * m.y >= 1, "large coefficient": lambda m: 1e8 * m.x >= m.y + 1,
}  # fmt: skip


def impossible(name: str, bounded: bool, expression: bool) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel(name=name)
    lower = 0.0 if bounded else None
    m.x, m.y = pyo.Var(bounds=(lower, None), initialize=1.0), pyo.Var(bounds=(lower, None), initialize=1.0)
    m.cost = pyo.Objective(expr=m.x + m.y)
    m.row = pyo.Constraint(expr=IMPOSSIBLE[name](m))
    first, second = (m.x + 0 * m.y, 2 * m.y) if expression else (m.x, m.y)
    m.pair = Complementarity(expr=complements(first >= 0, second >= 0))
    if name == "large coefficient":
        m.second_row = pyo.Constraint(expr=m.y >= 0.1)
    return m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bounded", "expression"),
    [("product", False, False), ("product", True, True), *((name, place % 2 == 0, place % 2 == 0) for place, name in enumerate(IMPOSSIBLE) if place)],
)  # fmt: skip
def test_nothing_is_optimal_where_nothing_is_feasible(name, bounded, expression):
    """Nor unbounded: iterates that leave for infinity while the objective rises prove nothing."""
    result = solve_mpec(impossible(name, bounded, expression))
    assert result.outcome not in (Outcome.SOLVED, Outcome.DIVERGED), result.message


@pytest.mark.parametrize(("x", "y"), [(5e-13, 2e12), (1e-9, 1e9), (2e12, 5e-13)])
def test_a_point_that_lives_on_the_tolerance_is_not_feasible(x, y):
    m = impossible("product", bounded=True, expression=False)
    m.x.value, m.y.value = x, y
    certificate = certify(m)
    assert certificate.complementarity <= 1e-8
    assert certificate.primal <= 1e-12
    assert certificate.forced == pytest.approx(1.0, abs=0.1)
    assert certificate.lives_on_tolerance
    assert not certificate.feasible
    assert "feasible only because complementarity is not exact" in certificate.sentence
    assert "stationary" not in certificate.sentence


def test_a_product_that_nothing_needs_is_feasible():
    """A large force beside a gap of 1e-9: nothing but the tolerance, and the constraints hold without it as well."""
    m = pyo.ConcreteModel()
    m.gap, m.force = pyo.Var(initialize=1e-9), pyo.Var(initialize=1e6)
    m.pull = pyo.Constraint(expr=m.force - 1e6 * m.gap == 1e6)
    m.pair = Complementarity(expr=complements(m.gap >= 0, m.force >= 0))
    certificate = certify(m)
    assert certificate.product == pytest.approx(1e-3)
    assert certificate.feasible


def test_sides_that_are_variables_end_exactly_at_zero():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(3), bounds=(0, None), initialize=0.3)
    m.y = pyo.Var(range(3), bounds=(0, None), initialize=0.4)
    m.cost = pyo.Objective(expr=sum((m.x[i] - i) ** 2 + (m.y[i] - 1) ** 2 for i in range(3)))
    m.pair = Complementarity(range(3), rule=lambda m, i: complements(m.x[i] >= 0, m.y[i] >= 0))
    pyo.SolverFactory("mpec_ipopt").solve(m)
    assert [min(m.x[i].value, m.y[i].value) for i in range(3)] == [0.0, 0.0, 0.0]


def test_every_branch_infeasible_is_told():
    m = impossible("large coefficient", bounded=True, expression=False)
    m.cap = pyo.Constraint(expr=m.y <= 1)
    result = solve_mpec(m)
    assert result.outcome is Outcome.INFEASIBLE
    assert "branches" in result.message


def test_a_descent_into_an_unbounded_branch_is_unbounded():
    """At the origin y alone may grow, where the objective falls without end."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=1.0), pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=m.x**2 - m.y)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    assert solve_mpec(m).outcome is Outcome.DIVERGED
