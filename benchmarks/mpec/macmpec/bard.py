"""Bard's bilevel programs. Mathematics of MacMPEC (S.

Leyffer), written anew for Pyomo; the m-variants use fewer multipliers.
"""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.macmpec.problem import problem


def _bard1(m: pyo.ConcreteModel, multiplier_bound: float | None) -> None:
    m.x, m.y = pyo.Var(bounds=(0, None)), pyo.Var(bounds=(0, None))
    m.l = pyo.Var([1, 2, 3], bounds=(multiplier_bound, None))
    m.cost = pyo.Objective(expr=(m.x - 5) ** 2 + (2 * m.y + 1) ** 2)
    sides = {1: 3 * m.x - m.y - 3, 2: -m.x + m.y / 2 + 4, 3: -m.x - m.y + 7}
    m.pair = Complementarity([1, 2, 3], rule=lambda m, i: complements(sides[i] >= 0, m.l[i] >= 0))


@problem(17.0)
def bard1(m: pyo.ConcreteModel) -> None:
    _bard1(m, None)
    m.follower = pyo.Constraint(
        expr=2 * (m.y - 1) - 1.5 * m.x + m.l[1] - 0.5 * m.l[2] + m.l[3] == 0
    )


@problem(17.0)
def bard1m(m: pyo.ConcreteModel) -> None:
    _bard1(m, 0.0)
    m.slack = pyo.Var(bounds=(0, None))
    m.follower = pyo.Constraint(
        expr=m.slack == 2 * (m.y - 1) - 1.5 * m.x + m.l[1] - 0.5 * m.l[2] + m.l[3]
    )


_SHARE = {(1, 1): 0.4, (1, 2): 0.7, (2, 1): 0.6, (2, 2): 0.3}  # (row of a division, its product)
_WISH = {(1, 1): 4.0, (1, 2): 13.0, (2, 1): 35.0, (2, 2): 2.0}  # (division, product)


def _divisions(m: pyo.ConcreteModel) -> None:
    """Two divisions share 40 units; each chooses its two products."""
    index = [(i, j) for i in (1, 2) for j in (1, 2)]
    m.x = pyo.Var(
        index, bounds=lambda m, i, j: (0, {(1, 1): 10, (1, 2): 5, (2, 1): 15, (2, 2): 20}[i, j])
    )
    m.y = pyo.Var(index, bounds=lambda m, i, j: (0, 20 if i == 1 else 40))
    m.common = pyo.Constraint(expr=sum(m.x.values()) <= 40)


def _revenue(m: pyo.ConcreteModel):
    one, two = m.y[1, 1] + m.y[2, 1], m.y[1, 2] + m.y[2, 2]
    return (200 - one) * one + (160 - two) * two


@problem(6598.0)
def bard2(m: pyo.ConcreteModel) -> None:
    _divisions(m)
    m.l = pyo.Var(m.x.index_set())
    m.revenue = pyo.Objective(expr=_revenue(m), sense=pyo.maximize)
    m.follower = pyo.Constraint(
        m.x.index_set(),
        rule=lambda m, i, j: (
            2 * (m.y[i, j] - _WISH[i, j]) + sum(_SHARE[r, j] * m.l[i, r] for r in (1, 2)) == 0
        ),
    )
    m.pair = Complementarity(
        m.x.index_set(),
        rule=lambda m, i, r: complements(
            m.x[i, r] - sum(_SHARE[r, j] * m.y[i, j] for j in (1, 2)) >= 0, m.l[i, r] >= 0
        ),
    )


@problem(-6598.0)
def bard2m(m: pyo.ConcreteModel) -> None:
    _divisions(m)
    m.l = pyo.Var(m.x.index_set(), bounds=(None, 0))
    m.cost = pyo.Objective(expr=-_revenue(m))
    m.pair = Complementarity(
        m.x.index_set(),
        rule=lambda m, i, r: complements(
            sum(_SHARE[r, j] * m.y[i, j] for j in (1, 2)) - m.x[i, r] <= 0, m.l[i, r] <= 0
        ),
    )
    m.follower = Complementarity(
        m.x.index_set(),
        rule=lambda m, i, j: complements(
            2 * (m.y[i, j] - _WISH[i, j]) - sum(_SHARE[r, j] * m.l[i, r] for r in (1, 2)) == 0,
            m.y[i, j],
        ),
    )


def _convex(m: pyo.ConcreteModel) -> dict:
    m.x, m.y, m.l = (pyo.Var([1, 2], bounds=(0, None)) for _ in range(3))
    m.cost = pyo.Objective(expr=-(m.x[1] ** 2) - 3 * m.x[2] - 4 * m.y[1] + m.y[2] ** 2)
    m.leader = pyo.Constraint(expr=m.x[1] ** 2 + 2 * m.x[2] <= 4)
    sides = {
        1: m.x[1] ** 2 - 2 * m.x[1] + m.x[2] ** 2 - 2 * m.y[1] + m.y[2] + 3,
        2: m.x[2] + 3 * m.y[1] - 4 * m.y[2] - 4,
    }
    m.pair = Complementarity([1, 2], rule=lambda m, i: complements(sides[i] >= 0, m.l[i] >= 0))
    return {1: 2 * m.y[1] + 2 * m.l[1] - 3 * m.l[2], 2: -5 - m.l[1] + 4 * m.l[2]}


@problem(-12.6787)
def bard3(m: pyo.ConcreteModel) -> None:
    slope = _convex(m)
    m.follower = pyo.Constraint([1, 2], rule=lambda m, i: slope[i] == 0)


@problem(-12.6787)
def bard3m(m: pyo.ConcreteModel) -> None:
    slope = _convex(m)
    m.follower = Complementarity([1, 2], rule=lambda m, i: complements(slope[i] >= 0, m.y[i] >= 0))
