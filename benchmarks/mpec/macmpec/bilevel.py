"""Bilevel programs through their lower level's optimality conditions. Mathematics of MacMPEC (S.

Leyffer), written anew for Pyomo.
"""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, ComplementarityList, complements

from benchmarks.mpec.macmpec.problem import problem


def _linear_leader(m: pyo.ConcreteModel, multipliers: int, low: float | None) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, 50))
    m.y = pyo.Var([1, 2])
    m.l = pyo.Var(range(1, multipliers + 1), bounds=(low, None))
    m.cost = pyo.Objective(expr=2 * m.x[1] + 2 * m.x[2] - 3 * m.y[1] - 3 * m.y[2] - 60)
    m.leader = pyo.Constraint(expr=m.x[1] + m.x[2] + m.y[1] - 2 * m.y[2] <= 40)


@problem(0.0)
def bilevel1(m: pyo.ConcreteModel) -> None:
    _linear_leader(m, 6, 0.0)
    m.follower = pyo.Constraint(
        [1, 2],
        rule=lambda m, i: (
            2 * m.y[i] - 2 * m.x[i] + 40 == m.l[2 * i - 1] - m.l[2 * i] - 2 * m.l[4 + i]
        ),
    )
    m.low = Complementarity(
        [1, 2], rule=lambda m, i: complements(m.y[i] + 10 >= 0, m.l[2 * i - 1] >= 0)
    )
    m.high = Complementarity(
        [1, 2], rule=lambda m, i: complements(20 - m.y[i] >= 0, m.l[2 * i] >= 0)
    )
    m.gap = Complementarity(
        [1, 2], rule=lambda m, i: complements(m.x[i] - 2 * m.y[i] - 10 >= 0, m.l[4 + i] >= 0)
    )


@problem(-55.0)
def bilevel1m(m: pyo.ConcreteModel) -> None:
    """Mixed complementarity: one multiplier for both bounds of a variable."""
    _linear_leader(m, 4, None)
    m.follower = pyo.Constraint(
        [1, 2], rule=lambda m, i: 2 * m.y[i] - 2 * m.x[i] + 40 == m.l[i] - 2 * m.l[2 + i]
    )
    m.box = Complementarity(
        [1, 2], rule=lambda m, i: complements(pyo.inequality(-10, m.y[i], 20), m.l[i])
    )
    m.gap = Complementarity(
        [1, 2], rule=lambda m, i: complements(m.x[i] - 2 * m.y[i] - 10 >= 0, m.l[2 + i] >= 0)
    )


_TOP = {1: 20.0, 2: 20.0, 3: 40.0, 4: 40.0}
_WISH = {1: 4.0, 2: 13.0, 3: 35.0, 4: 2.0}
_USE = {
    (1, 1): 0.4,
    (1, 2): 0.7,
    (2, 1): 0.6,
    (2, 2): 0.3,
    (3, 3): 0.4,
    (3, 4): 0.7,
    (4, 3): 0.6,
    (4, 4): 0.3,
}


def _factories(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var(
        [1, 2, 3, 4],
        bounds=lambda m, i: (0, {1: 10, 2: 5, 3: 15, 4: 20}[i]),
        initialize={1: 5, 2: 5, 3: 15, 4: 15},
    )
    m.y = pyo.Var([1, 2, 3, 4])
    m.price = pyo.Var([1, 2, 3, 4], bounds=(0, None))
    m.cost = pyo.Objective(
        expr=-(200 - m.y[1] - m.y[3]) * (m.y[1] + m.y[3])
        - (160 - m.y[2] - m.y[4]) * (m.y[2] + m.y[4])
    )
    m.common = pyo.Constraint(expr=sum(m.x.values()) <= 40)
    m.capacity = Complementarity(
        [1, 2, 3, 4],
        rule=lambda m, r: complements(
            m.x[r] - sum(_USE[r, j] * m.y[j] for j in (1, 2, 3, 4) if (r, j) in _USE) >= 0,
            m.price[r] >= 0,
        ),
    )


def _paid(m: pyo.ConcreteModel, j: int):
    return sum(_USE[r, j] * m.price[r] for r in (1, 2, 3, 4) if (r, j) in _USE)


@problem(-6600.0)
def bilevel2(m: pyo.ConcreteModel) -> None:
    _factories(m)
    m.low, m.high = pyo.Var([1, 2, 3, 4], bounds=(0, None)), pyo.Var([1, 2, 3, 4], bounds=(0, None))
    m.follower = pyo.Constraint(
        [1, 2, 3, 4], rule=lambda m, j: m.y[j] - _WISH[j] + _paid(m, j) - m.low[j] + m.high[j] == 0
    )
    m.bounds = ComplementarityList()
    for j in (1, 2, 3, 4):
        m.bounds.add(complements(m.y[j] >= 0, m.low[j] >= 0))
        m.bounds.add(complements(_TOP[j] - m.y[j] >= 0, m.high[j] >= 0))


@problem(-6600.0)
def bilevel2m(m: pyo.ConcreteModel) -> None:
    _factories(m)
    m.l = pyo.Var([1, 2, 3, 4])
    m.follower = pyo.Constraint(
        [1, 2, 3, 4], rule=lambda m, j: m.y[j] - _WISH[j] + _paid(m, j) - m.l[j] == 0
    )
    m.box = Complementarity(
        [1, 2, 3, 4], rule=lambda m, j: complements(m.l[j], pyo.inequality(0, m.y[j], _TOP[j]))
    )


@problem(-12.6787)
def bilevel3(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, None), initialize={1: 0, 2: 2})
    m.y = pyo.Var(range(1, 7))
    m.l = pyo.Var(range(1, 5))
    m.cost = pyo.Objective(expr=-(m.x[1] ** 2) - 3 * m.x[2] - 4 * m.y[1] + m.y[2] ** 2)
    m.leader = pyo.Constraint(expr=m.x[1] ** 2 + 2 * m.x[2] <= 4)
    rows = (
        2 * m.y[1] + 2 * m.y[3] - 3 * m.y[4] - m.y[5],
        -5 - m.y[3] + 4 * m.y[4] - m.y[6],
        m.x[1] ** 2 - 2 * m.x[1] + m.x[2] ** 2 - 2 * m.y[1] + m.y[2] + 3 - m.l[1],
        m.x[2] + 3 * m.y[1] - 4 * m.y[2] - 4 - m.l[2],
        m.y[1] - m.l[3],
        m.y[2] - m.l[4],
    )
    m.follower = pyo.Constraint(range(6), rule=lambda m, k: rows[k] == 0)
    m.pair = Complementarity(
        range(1, 5), rule=lambda m, i: complements(m.l[i] >= 0, m.y[2 + i] >= 0)
    )


@problem(18.4)
def bilin(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, None), initialize=1)
    m.y = pyo.Var(range(1, 7), bounds=(0, None), initialize=1)
    x, y = m.x, m.y
    m.gain = pyo.Objective(
        expr=8 * x[1] + 4 * x[2] - 4 * y[1] + 40 * y[2] + 4 * y[3], sense=pyo.maximize
    )
    m.leader = pyo.Constraint(expr=x[1] + 2 * x[2] - y[3] <= 1.3)
    sides = (
        2 - y[4] - 2 * y[5] + 4 * y[6],
        1 + y[4] + 4 * y[5] - 2 * y[6],
        2 + y[4] - y[5] - y[6],
        1 + y[1] - y[2] - y[3],
        2 - 4 * x[1] + 2 * y[1] - 4 * y[2] + y[3],
        2 - 4 * x[2] - 4 * y[1] + 2 * y[2] + y[3],
    )
    m.pair = Complementarity(
        range(1, 7), rule=lambda m, i: complements(sides[i - 1] >= 0, m.y[i] >= 0)
    )


@problem(28.25)
def dempe(m: pyo.ConcreteModel) -> None:
    m.x, m.z = pyo.Var(initialize=0.183193), pyo.Var(initialize=0.428106)
    m.w = pyo.Var(bounds=(0, None), initialize=3.00379)
    m.cost = pyo.Objective(expr=(m.x - 3.5) ** 2 + (m.z + 4) ** 2)
    m.follower = pyo.Constraint(expr=m.z - 3 + 2 * m.z * m.w == 0)
    m.pair = Complementarity(expr=complements(m.z**2 - m.x <= 0, m.w >= 0))


@problem(-1.0)
def desilva(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, 2))
    m.y = pyo.Var([1, 2])
    m.l = pyo.Var([1, 2], bounds=(0, None))
    m.cost = pyo.Objective(expr=sum(m.x[i] ** 2 - 2 * m.x[i] + m.y[i] ** 2 for i in (1, 2)))
    m.follower = pyo.Constraint(
        [1, 2], rule=lambda m, i: 2 * (m.y[i] - m.x[i]) + 2 * (m.y[i] - 1) * m.l[i] == 0
    )
    m.pair = Complementarity(
        [1, 2], rule=lambda m, i: complements(0.25 - (m.y[i] - 1) ** 2 >= 0, m.l[i] >= 0)
    )


@problem(24.3668)
def hakonsen(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, None), initialize=1)
    m.leisure = pyo.Var(bounds=(0, None), initialize=1)
    m.p, m.t = pyo.Var([1, 2], bounds=(0, None)), pyo.Var([1, 2], bounds=(0, None))
    m.utility = pyo.Objective(expr=(m.x[1] * m.x[2] * m.leisure) ** (1 / 3), sense=pyo.maximize)
    m.price = Complementarity([1, 2], rule=lambda m, i: complements(m.p[i] <= 1, m.x[i] >= 0))
    m.demand = Complementarity(
        [1, 2],
        rule=lambda m, i: complements(3 * m.x[i] * m.p[i] * (1 + m.t[i]) >= 100, m.p[i] >= 0),
    )
    m.budget = pyo.Constraint(expr=sum(m.x[i] * m.p[i] for i in (1, 2)) + m.leisure + 25 == 100)
    m.revenue = pyo.Constraint(expr=sum(m.p[i] * m.t[i] * m.x[i] for i in (1, 2)) >= 25)


@problem(0.0001)
def sl1(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2])
    m.z = pyo.Var([1, 2, 3], bounds=lambda m, i: {1: (10, 1e10), 2: (0.01, 10), 3: (0, 1)}[i])
    m.l = pyo.Var([1, 2, 3], bounds=(0, None))
    m.cost = pyo.Objective(expr=(m.x[1] - 2) ** 2 + m.x[2] ** 2)
    m.first = pyo.Constraint(expr=0.02 * m.x[1] - 10 * m.l[1] - m.l[2] == 0)
    m.second = pyo.Constraint(expr=2 * m.x[2] - m.l[1] - m.l[3] == 0)
    sides = {1: 10 * m.x[1] + m.x[2] - 10 - m.z[1], 2: m.x[1] - 2 - m.z[2], 3: m.x[2] - 50 * m.z[3]}
    m.pair = Complementarity([1, 2, 3], rule=lambda m, i: complements(sides[i] >= 0, m.l[i] >= 0))
