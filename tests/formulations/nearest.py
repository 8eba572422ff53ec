"""The MPEC that most tests begin with."""

from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements


def nearest(x: float | None = 1.0, y: float | None = 1.0) -> pyo.ConcreteModel:
    """The point of the two half-axes that is nearest to (1, 2), from (x, y)."""
    m = pyo.ConcreteModel(name="nearest")
    m.x, m.y = pyo.Var(initialize=x), pyo.Var(initialize=y)
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 2) ** 2)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    return m


def solver(**options: Any) -> Any:
    made = pyo.SolverFactory("mpec_ipopt")
    made.options.update(options)
    return made
