"""Small problems of MacMPEC (S. Leyffer), written anew for Pyomo, with the optima that the collection publishes.

Each shows one thing that can go wrong. The whole collection is measured from its `.nl` files, by
`python -m benchmarks mpec-sets`.
"""

from __future__ import annotations

from collections.abc import Callable

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements


def jr1() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(), pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 + m.b**2)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))
    return m


def ralph1() -> pyo.ConcreteModel:
    """The origin is B-stationary, but has no multipliers of an S point."""
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(bounds=(0, None)), pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=2 * m.a - m.b)
    m.pair = Complementarity(expr=complements(m.b >= 0, m.b - m.a >= 0))
    return m


def ralph2() -> pyo.ConcreteModel:
    """Unbounded without the complementarity."""
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(bounds=(0, None), initialize=1), pyo.Var(initialize=1)
    m.cost = pyo.Objective(expr=m.a**2 + m.b**2 - 4 * m.a * m.b)
    m.pair = Complementarity(expr=complements(m.a >= 0, m.b >= 0))
    return m


def kth3() -> pyo.ConcreteModel:
    """Two local solutions: 0.5 at (0, 1), 1 at (1, 0)."""
    m = pyo.ConcreteModel()
    m.a, m.b = (pyo.Var(bounds=(0, None), initialize=1) for _ in range(2))
    m.cost = pyo.Objective(expr=(m.a - 1) ** 2 / 2 + (m.b - 1) ** 2)
    m.pair = Complementarity(expr=complements(m.a >= 0, m.b >= 0))
    return m


def df1() -> pyo.ConcreteModel:
    """Curved rows and a curved side."""
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(bounds=(-1, 2)), pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=(m.a - 1 - m.b) ** 2)
    m.circle = pyo.Constraint(expr=m.a**2 <= 2)
    m.disc = pyo.Constraint(expr=(m.a - 1) ** 2 + (m.b - 1) ** 2 <= 3)
    m.pair = Complementarity(expr=complements(m.b - m.a**2 + 1 >= 0, m.b >= 0))
    return m


def gauvin() -> pyo.ConcreteModel:
    """The follower's conditions as two pairs with a multiplier."""
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(bounds=(0, 15), initialize=7.5), pyo.Var(bounds=(0, None))
    m.u = pyo.Var(bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=m.a**2 + (m.b - 10) ** 2)
    m.slope = Complementarity(expr=complements(4 * (m.a + 2 * m.b - 30) + m.u >= 0, m.b >= 0))
    m.limit = Complementarity(expr=complements(20 - m.a - m.b >= 0, m.u >= 0))
    return m


def scale4() -> pyo.ConcreteModel:
    """Variables in units a hundred times too large."""
    m = pyo.ConcreteModel()
    m.a, m.b = pyo.Var(), pyo.Var()
    m.cost = pyo.Objective(expr=(100 * m.a - 1) ** 2 + (100 * m.b - 1) ** 2)
    m.pair = Complementarity(expr=complements(m.a >= 0, m.b >= 0))
    return m


def scholtes1() -> pyo.ConcreteModel:
    """Exponential functions in a side."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(bounds=(0, None), initialize=1)
    m.y = pyo.Var([1, 2], initialize=1)
    m.cost = pyo.Objective(expr=(m.x + 1) ** 2 + (m.y[1] - 2.5) ** 2 + (m.y[2] + 1) ** 2)
    m.sign = pyo.Constraint(expr=m.y[2] >= 0)
    m.pair = Complementarity(
        expr=complements(m.y[1] - pyo.exp(m.x) - pyo.exp(m.y[2]) >= 0, m.x >= 0)
    )
    return m


def scholtes4() -> pyo.ConcreteModel:
    """The solution is not S-stationary; multipliers grow along every relaxation."""
    m = pyo.ConcreteModel()
    m.z = pyo.Var([1, 2], bounds=(0, None), initialize={1: 0, 2: 1})
    m.top = pyo.Var(initialize=0)
    m.cost = pyo.Objective(expr=m.z[1] + m.z[2] - m.top)
    m.below = pyo.Constraint([1, 2], rule=lambda m, i: m.top <= 4 * m.z[i])
    m.pair = Complementarity(expr=complements(m.z[1] >= 0, m.z[2] >= 0))
    return m


# Model -> the published optimum.
OPTIMA: dict[Callable[[], pyo.ConcreteModel], float] = {
    jr1: 0.5,
    ralph1: 0.0,
    ralph2: 0.0,
    kth3: 0.5,
    df1: 0.0,
    gauvin: 20.0,
    scale4: 1.0,
    scholtes1: 2.0,
    scholtes4: 0.0,
}
