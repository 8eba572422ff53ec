"""One or two variables, one pair: each shows one thing that can go wrong. Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo."""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements


def _two(first: float | None, second: float | None, low: tuple[float | None, float | None] = (0.0, 0.0)) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.a = pyo.Var(bounds=(low[0], None), initialize=first)
    m.b = pyo.Var(bounds=(low[1], None), initialize=second)
    return m


def _axes(m: pyo.ConcreteModel) -> None:
    m.pair = Complementarity(expr=complements(m.a >= 0, m.b >= 0))


def kth1() -> pyo.ConcreteModel:
    m = _two(0.0, 1.0)
    m.cost = pyo.Objective(expr=m.a + m.b)
    _axes(m)
    return m


def kth2() -> pyo.ConcreteModel:
    m = _two(1.0, 0.0)
    m.cost = pyo.Objective(expr=m.a + (m.b - 1) ** 2)
    _axes(m)
    return m


def kth3() -> pyo.ConcreteModel:
    """Two local solutions: 0.5 at (0, 1), 1 at (1, 0)."""
    m = _two(1.0, 1.0)
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 / 2 + (m.b - 1) ** 2)
    _axes(m)
    return m


def jr1() -> pyo.ConcreteModel:
    m = _two(None, None, (None, 0.0))
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 + m.b**2)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))
    return m


def jr2() -> pyo.ConcreteModel:
    m = _two(None, None, (None, 0.0))
    m.cost = pyo.Objective(expr=(m.b - 1) ** 2 + m.a**2)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))
    return m


def ralph1() -> pyo.ConcreteModel:
    """The origin is B-stationary, but has no multipliers of an S point."""
    m = _two(None, None)
    m.cost = pyo.Objective(expr=2 * m.a - m.b)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))
    return m


def ralph2() -> pyo.ConcreteModel:
    """Unbounded without the complementarity."""
    m = _two(1.0, 1.0, (0.0, None))
    m.cost = pyo.Objective(expr=m.a**2 + m.b**2 - 4 * m.a * m.b)
    _axes(m)
    return m


def df1() -> pyo.ConcreteModel:
    m = _two(None, None, (-1.0, 0.0))
    m.a.setub(2)
    m.cost = pyo.Objective(expr=(m.a - 1 - m.b) ** 2)
    m.circle = pyo.Constraint(expr=m.a**2 <= 2)
    m.disc = pyo.Constraint(expr=(m.a - 1) ** 2 + (m.b - 1) ** 2 <= 3)
    m.pair = Complementarity(expr=complements(m.b - m.a**2 + 1 >= 0, m.b >= 0))
    return m


def gauvin() -> pyo.ConcreteModel:
    m = _two(7.5, None)
    m.a.setub(15)
    m.u = pyo.Var(bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=m.a**2 + (m.b - 10) ** 2)
    m.slope = Complementarity(expr=complements(4 * (m.a + 2 * m.b - 30) + m.u >= 0, m.b >= 0))
    m.limit = Complementarity(expr=complements(20 - m.a - m.b >= 0, m.u >= 0))
    return m


def stackelberg1() -> pyo.ConcreteModel:
    m = _two(None, None)
    m.a.setub(200)
    m.multiplier = pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=m.a**2 / 2 + m.a * m.b / 2 - 95 * m.a)
    m.follower = pyo.Constraint(expr=2 * m.b + m.a / 2 - 100 - m.multiplier == 0)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.multiplier >= 0))
    return m


def _scaled(weights: tuple[float, float], stretch: tuple[float, float]) -> pyo.ConcreteModel:
    m = _two(None, None, (None, None))
    m.cost = pyo.Objective(expr=weights[0] * (stretch[0] * m.a - 1) ** 2 + weights[1] * (stretch[1] * m.b - 1) ** 2)
    _axes(m)
    return m


def scale1() -> pyo.ConcreteModel:
    return _scaled((1, 1), (100, 1))


def scale2() -> pyo.ConcreteModel:
    return _scaled((100, 1), (1, 1))


def scale3() -> pyo.ConcreteModel:
    return _scaled((1, 100), (100, 1))


def scale4() -> pyo.ConcreteModel:
    return _scaled((1, 1), (100, 100))


def scale5() -> pyo.ConcreteModel:
    return _scaled((100, 100), (1, 1))


def flp2() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], bounds=(0, 10))
    m.y = pyo.Var([1, 2], bounds=(0, None))
    m.cost = pyo.Objective(expr=sum((m.x[1] + m.x[2] + m.y[i] - 15) ** 2 for i in (1, 2)) / 2)
    m.one = Complementarity(expr=complements(m.y[1] >= 0, 8 / 3 * m.x[1] + 2 * m.x[2] + 2 * m.y[1] + 8 / 3 * m.y[2] - 36 >= 0))
    m.two = Complementarity(expr=complements(m.y[2] >= 0, 2 * m.x[1] + 1.25 * m.x[2] + 1.25 * m.y[1] + 2 * m.y[2] - 25 >= 0))
    return m


_SOURCE = "MacMPEC index, S. Leyffer"
PROBLEMS = (
    (kth1, 0.0, _SOURCE),
    (kth2, 0.0, _SOURCE),
    (kth3, 0.5, _SOURCE),
    (jr1, 0.5, _SOURCE),
    (jr2, 0.5, _SOURCE),
    (ralph1, 0.0, _SOURCE),
    (ralph2, 0.0, _SOURCE),
    (df1, 0.0, _SOURCE),
    (gauvin, 20.0, _SOURCE),
    (stackelberg1, -3266.67, _SOURCE),
    (scale1, 1.0, _SOURCE),
    (scale2, 1.0, _SOURCE),
    (scale3, 1.0, _SOURCE),
    (scale4, 1.0, _SOURCE),
    (scale5, 100.0, _SOURCE),
    (flp2, 0.0, _SOURCE),
)
