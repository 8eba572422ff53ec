"""One or two variables, one pair: each shows one thing that can go wrong.

Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo.
"""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.macmpec.problem import problem


def _two(
    m: pyo.ConcreteModel,
    first: float | None,
    second: float | None,
    low: tuple[float | None, float | None] = (0.0, 0.0),
) -> None:
    m.a = pyo.Var(bounds=(low[0], None), initialize=first)
    m.b = pyo.Var(bounds=(low[1], None), initialize=second)


def _axes(m: pyo.ConcreteModel) -> None:
    m.pair = Complementarity(expr=complements(m.a >= 0, m.b >= 0))


@problem(0.0)
def kth1(m: pyo.ConcreteModel) -> None:
    _two(m, 0.0, 1.0)
    m.cost = pyo.Objective(expr=m.a + m.b)
    _axes(m)


@problem(0.0)
def kth2(m: pyo.ConcreteModel) -> None:
    _two(m, 1.0, 0.0)
    m.cost = pyo.Objective(expr=m.a + (m.b - 1) ** 2)
    _axes(m)


@problem(0.5)
def kth3(m: pyo.ConcreteModel) -> None:
    """Two local solutions: 0.5 at (0, 1), 1 at (1, 0)."""
    _two(m, 1.0, 1.0)
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 / 2 + (m.b - 1) ** 2)
    _axes(m)


@problem(0.5)
def jr1(m: pyo.ConcreteModel) -> None:
    _two(m, None, None, (None, 0.0))
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 + m.b**2)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))


@problem(0.5)
def jr2(m: pyo.ConcreteModel) -> None:
    _two(m, None, None, (None, 0.0))
    m.cost = pyo.Objective(expr=(m.b - 1) ** 2 + m.a**2)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))


@problem(0.0)
def ralph1(m: pyo.ConcreteModel) -> None:
    """The origin is B-stationary, but has no multipliers of an S point."""
    _two(m, None, None)
    m.cost = pyo.Objective(expr=2 * m.a - m.b)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))


@problem(0.0)
def ralph2(m: pyo.ConcreteModel) -> None:
    """Unbounded without the complementarity."""
    _two(m, 1.0, 1.0, (0.0, None))
    m.cost = pyo.Objective(expr=m.a**2 + m.b**2 - 4 * m.a * m.b)
    _axes(m)


@problem(0.0)
def df1(m: pyo.ConcreteModel) -> None:
    _two(m, None, None, (-1.0, 0.0))
    m.a.setub(2)
    m.cost = pyo.Objective(expr=(m.a - 1 - m.b) ** 2)
    m.circle = pyo.Constraint(expr=m.a**2 <= 2)
    m.disc = pyo.Constraint(expr=(m.a - 1) ** 2 + (m.b - 1) ** 2 <= 3)
    m.pair = Complementarity(expr=complements(m.b - m.a**2 + 1 >= 0, m.b >= 0))


@problem(20.0)
def gauvin(m: pyo.ConcreteModel) -> None:
    _two(m, 7.5, None)
    m.a.setub(15)
    m.u = pyo.Var(bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=m.a**2 + (m.b - 10) ** 2)
    m.slope = Complementarity(expr=complements(4 * (m.a + 2 * m.b - 30) + m.u >= 0, m.b >= 0))
    m.limit = Complementarity(expr=complements(20 - m.a - m.b >= 0, m.u >= 0))


@problem(-3266.67)
def stackelberg1(m: pyo.ConcreteModel) -> None:
    _two(m, None, None)
    m.a.setub(200)
    m.multiplier = pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=m.a**2 / 2 + m.a * m.b / 2 - 95 * m.a)
    m.follower = pyo.Constraint(expr=2 * m.b + m.a / 2 - 100 - m.multiplier == 0)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.multiplier >= 0))


def _scaled(
    m: pyo.ConcreteModel, weights: tuple[float, float], stretch: tuple[float, float]
) -> None:
    _two(m, None, None, (None, None))
    m.cost = pyo.Objective(
        expr=weights[0] * (stretch[0] * m.a - 1) ** 2 + weights[1] * (stretch[1] * m.b - 1) ** 2
    )
    _axes(m)


for _number, _optimum, _weights, _stretch in (
    (1, 1.0, (1, 1), (100, 1)), (2, 1.0, (100, 1), (1, 1)), (3, 1.0, (1, 100), (100, 1)),
    (4, 1.0, (1, 1), (100, 100)), (5, 100.0, (100, 100), (1, 1)),
):  # fmt: skip
    problem(_optimum, f"scale{_number}", _weights, _stretch)(_scaled)


@problem(0.0)
def flp2(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, 10))
    m.y = pyo.Var([1, 2], bounds=(0, None))
    m.cost = pyo.Objective(expr=sum((m.x[1] + m.x[2] + m.y[i] - 15) ** 2 for i in (1, 2)) / 2)
    m.one = Complementarity(
        expr=complements(
            m.y[1] >= 0, 8 / 3 * m.x[1] + 2 * m.x[2] + 2 * m.y[1] + 8 / 3 * m.y[2] - 36 >= 0
        )
    )
    m.two = Complementarity(
        expr=complements(
            m.y[2] >= 0, 2 * m.x[1] + 1.25 * m.x[2] + 1.25 * m.y[1] + 2 * m.y[2] - 25 >= 0
        )
    )
