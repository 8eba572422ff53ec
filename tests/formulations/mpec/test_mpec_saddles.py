"""What first order does not see: a maximum or a saddle of a branch is left along directions in which its Lagrangian curves downwards, or that is told."""

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations.mpec import solve_mpec
from formulations.solution import Outcome


def _with_pair():
    """Beside a pair that is (0, 2) at the solution and costs 1."""
    m = pyo.ConcreteModel()
    m.v, m.w = pyo.Var(bounds=(0, None), initialize=0.0), pyo.Var(bounds=(0, None), initialize=0.0)
    m.pair = Complementarity(expr=complements(m.v >= 0, m.w >= 0))
    return m, (m.v - 1) ** 2 + (m.w - 2) ** 2


def _hilltop(count):
    """A maximum between the corners of a box, whose plane through the middle keeps the sum."""
    m, pull = _with_pair()
    m.x = pyo.Var(range(count), bounds=(-1, 1), initialize=0.0)
    m.cost = pyo.Objective(expr=pull - sum(m.x[i] ** 2 for i in m.x))
    m.row = pyo.Constraint(expr=sum(m.x[i] for i in m.x) == 0)
    return m


def _top_of_circle():
    """The objective is linear: what curves downwards is the row."""
    m, pull = _with_pair()
    m.x, m.y = pyo.Var(initialize=0.0), pyo.Var(initialize=1.0)
    m.row = pyo.Constraint(expr=m.x**2 + m.y**2 == 1)
    m.cost = pyo.Objective(expr=pull + m.y)
    return m


def _two_wells():
    """A maximum in both directions at the origin; at (+-1, +-sqrt(1/2)) it is 0 - 1/4."""
    m, pull = _with_pair()
    m.x, m.y = pyo.Var(initialize=0.0), pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=pull + (m.x**2 - 1) ** 2 - m.y**2 + m.y**4)
    return m


_COUNT = 6
_COUPLING = 0.1


def _many_wells(sense=pyo.minimize):
    """A maximum in as many directions as there are variables, coupled by their squares.

    What Ipopt does there is slow.
    """
    m, pull = _with_pair()
    m.x = pyo.Var(range(_COUNT), initialize=0.0)
    wells = sum((k + 1) * (m.x[k] ** 2 - 1) ** 2 for k in m.x) + _COUPLING * sum(
        m.x[k] ** 2 * m.x[k + 1] ** 2 for k in range(_COUNT - 1)
    )
    m.cost = pyo.Objective(
        expr=(pull + wells) if sense == pyo.minimize else -(pull + wells), sense=sense
    )
    return m


def _lowest_of_many_wells():
    """A convex quadratic program of the squares, which are positive at its solution."""
    weights, beside = np.arange(1.0, _COUNT + 1), np.eye(_COUNT, k=1)
    squares = np.linalg.solve(np.diag(2 * weights) + _COUPLING * (beside + beside.T), 2 * weights)
    return 1.0 + weights @ (squares - 1) ** 2 + _COUPLING * squares @ beside @ squares


def _flat_beside_steep():
    m, pull = _with_pair()
    m.x, m.y = pyo.Var(initialize=0.0), pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=pull + 1e8 * m.y**2 - m.x**2 + m.x**4)
    return m


def _better_branch_beyond():
    """At x = 0, a maximum of both branches, v = 0 is the better one.

    At x = 1, where v = 2 costs nothing, w = 0 is.
    """
    m, _ = _with_pair()
    m.x = pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=(m.x**2 - 1) ** 2 + (m.v - 2 * m.x**2) ** 2 + (m.w - 0.5) ** 2)
    return m


@pytest.mark.parametrize(
    ("model", "optimum"),
    [
        (_hilltop(2), 1.0 - 2.0), (_hilltop(200), 1.0 - 200.0), (_top_of_circle(), 1.0 - 1.0),
        (_two_wells(), 0.75),
        (_many_wells(), _lowest_of_many_wells()),
        (_many_wells(pyo.maximize), -_lowest_of_many_wells()),
        (_flat_beside_steep(), 0.75), (_better_branch_beyond(), 0.25),
    ],
)  # fmt: skip
def test_a_maximum_where_the_search_starts_is_left(model, optimum):
    result = solve_mpec(model)
    assert result.solved
    assert result.objective == pytest.approx(optimum, abs=1e-8)
    assert "curves" not in result.message


@pytest.mark.parametrize("count", [3, 200])
def test_a_minimum_of_what_the_rows_leave_is_kept(count):
    """x y is a saddle, x x on the plane x = y is none."""
    m, pull = _with_pair()
    m.x, m.y = pyo.Var(range(count), initialize=0.0), pyo.Var(range(count), initialize=0.0)
    m.row = pyo.Constraint(range(count), rule=lambda m, i: m.x[i] == m.y[i])
    m.cost = pyo.Objective(expr=pull + sum(m.x[i] * m.y[i] for i in m.x))
    result = solve_mpec(m)
    assert (result.solved, result.objective) == (True, pytest.approx(1.0, abs=1e-9))
    assert "curves" not in result.message


def test_a_maximum_above_an_unbounded_branch_is_unbounded():
    """x y on the line x + y = 1 is largest at (1/2, 1/2), and falls without end on both sides."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=0.0), pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=m.x * m.y)
    m.strip = Complementarity(expr=complements(m.x + m.y >= -1, 1 - m.x - m.y >= 0))
    assert solve_mpec(m).outcome is Outcome.DIVERGED


def test_a_curvature_that_leads_nowhere_is_told():
    """x^4 <= 0 leaves nothing but x = 0, to no order that the Lagrangian sees."""
    m, pull = _with_pair()
    m.x = pyo.Var(initialize=0.0)
    m.row = pyo.Constraint(expr=m.x**4 <= 0)
    m.cost = pyo.Objective(expr=pull - m.x**2)
    result = solve_mpec(m)
    assert (result.solved, result.objective) == (True, pytest.approx(1.0))
    assert (
        "curves downwards along a direction, but no better point was found there" in result.message
    )
