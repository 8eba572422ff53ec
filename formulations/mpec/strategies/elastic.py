"""f + (1 / eps) t with v w <= t, t >= 0 (elastic mode): feasible wherever the constraints without products are."""

from __future__ import annotations

import pyomo.environ as pyo

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy, replace_objective


class Elastic(Strategy):
    name = "elastic"
    title = "one elastic bound on all products, penalised"
    last = 1e-8

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=False)
        shadow = lifted.shadow
        shadow.weight = pyo.Param(mutable=True, initialize=1.0)
        shadow.elastic = pyo.Var(bounds=(0.0, None), initialize=1.0)
        sides = list(zip(lifted.firsts, lifted.seconds, strict=True))
        shadow.elastic_product = pyo.Constraint(range(len(sides)), rule=lambda _, k: sides[k][0] * sides[k][1] <= shadow.elastic)
        replace_objective(shadow, shadow.weight * shadow.elastic)

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.weight.value = 1.0 / eps


STRATEGY = Elastic()
