"""Scholtes's examples. Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo."""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.macmpec.problem import problem


def _exponential(m: pyo.ConcreteModel, linear: float, weight: float) -> None:
    m.x = pyo.Var(bounds=(0, None), initialize=1)
    m.y = pyo.Var([1, 2], initialize=1)
    m.cost = pyo.Objective(
        expr=(m.x + 1) ** 2 + (m.y[1] - linear) ** 2 + weight * (m.y[2] + 1) ** 2
    )
    m.sign = pyo.Constraint(expr=m.y[2] >= 0)
    m.pair = Complementarity(
        expr=complements(m.y[1] - pyo.exp(m.x) - pyo.exp(m.y[2]) >= 0, m.x >= 0)
    )


problem(2.0, "scholtes1", 2.5, 1.0)(_exponential)
problem(15.0, "scholtes2", 0.0, 10.0)(_exponential)


@problem(0.5)
def scholtes3(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, None), initialize=1e-4)
    m.cost = pyo.Objective(expr=((m.x[1] - 1) ** 2 + (m.x[2] - 1) ** 2) / 2)
    m.pair = Complementarity(expr=complements(m.x[1] >= 0, m.x[2] >= 0))


@problem(0.0)
def scholtes4(m: pyo.ConcreteModel) -> None:
    """The solution is C- and M-stationary with multipliers that grow along every relaxation."""
    m.z = pyo.Var([1, 2], bounds=(0, None), initialize={1: 0, 2: 1})
    m.top = pyo.Var(initialize=0)
    m.cost = pyo.Objective(expr=m.z[1] + m.z[2] - m.top)
    m.below = pyo.Constraint([1, 2], rule=lambda m, i: m.top <= 4 * m.z[i])
    m.pair = Complementarity(expr=complements(m.z[1] >= 0, m.z[2] >= 0))


@problem(1.0)
def scholtes5(m: pyo.ConcreteModel) -> None:
    m.z = pyo.Var([1, 2, 3], bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=(m.z[1] - 1) ** 2 + (m.z[2] - 2) ** 2 + (m.z[3] + 1) ** 2)
    m.pair = Complementarity([1, 2], rule=lambda m, i: complements(m.z[i] >= 0, m.z[3] >= 0))
