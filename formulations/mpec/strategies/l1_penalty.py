"""f + (1 / eps) sum v w: the products in the objective. Exact: a finite weight is enough where the solution is strongly stationary."""

from __future__ import annotations

import pyomo.environ as pyo

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy, replace_objective


class L1Penalty(Strategy):
    name = "l1_penalty"
    title = "products as a penalty in the objective"
    last = 1e-8

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=False)
        shadow = lifted.shadow
        shadow.weight = pyo.Param(mutable=True, initialize=1.0)
        pairs = zip(lifted.firsts, lifted.seconds, strict=True)
        replace_objective(shadow, sum((shadow.weight * first * second for first, second in pairs), start=0.0))

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.weight.value = 1.0 / eps


STRATEGY = L1Penalty()
