"""Scholtes's examples. Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo."""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements


def _exponential(linear: float, weight: float) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var(bounds=(0, None), initialize=1)
    m.y = pyo.Var([1, 2], initialize=1)
    m.cost = pyo.Objective(expr=(m.x + 1) ** 2 + (m.y[1] - linear) ** 2 + weight * (m.y[2] + 1) ** 2)
    m.sign = pyo.Constraint(expr=m.y[2] >= 0)
    m.pair = Complementarity(expr=complements(m.y[1] - pyo.exp(m.x) - pyo.exp(m.y[2]) >= 0, m.x >= 0))
    return m


def scholtes1() -> pyo.ConcreteModel:
    return _exponential(2.5, 1.0)


def scholtes2() -> pyo.ConcreteModel:
    return _exponential(0.0, 10.0)


def scholtes3() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], bounds=(0, None), initialize=1e-4)
    m.cost = pyo.Objective(expr=((m.x[1] - 1) ** 2 + (m.x[2] - 1) ** 2) / 2)
    m.pair = Complementarity(expr=complements(m.x[1] >= 0, m.x[2] >= 0))
    return m


def scholtes4() -> pyo.ConcreteModel:
    """The solution is C- and M-stationary with multipliers that grow along every relaxation."""
    m = pyo.ConcreteModel()
    m.z = pyo.Var([1, 2], bounds=(0, None), initialize={1: 0, 2: 1})
    m.top = pyo.Var(initialize=0)
    m.cost = pyo.Objective(expr=m.z[1] + m.z[2] - m.top)
    m.below = pyo.Constraint([1, 2], rule=lambda m, i: m.top <= 4 * m.z[i])
    m.pair = Complementarity(expr=complements(m.z[1] >= 0, m.z[2] >= 0))
    return m


def scholtes5() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.z = pyo.Var([1, 2, 3], bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=(m.z[1] - 1) ** 2 + (m.z[2] - 2) ** 2 + (m.z[3] + 1) ** 2)
    m.pair = Complementarity([1, 2], rule=lambda m, i: complements(m.z[i] >= 0, m.z[3] >= 0))
    return m


_SOURCE = "MacMPEC index, S. Leyffer"
PROBLEMS = (
    (scholtes1, 2.0, _SOURCE),
    (scholtes2, 15.0, _SOURCE),
    (scholtes3, 0.5, _SOURCE),
    (scholtes4, 0.0, _SOURCE),
    (scholtes5, 1.0, _SOURCE),
)
