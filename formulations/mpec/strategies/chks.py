"""v + w = sqrt((v - w)^2 + 4 eps) (Chen, Harker, Kanzow, Smale): the same path v w = eps as Fischer-Burmeister, by another equation."""

from __future__ import annotations

import pyomo.environ as pyo

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy


class Chks(Strategy):
    name = "chks"
    title = "Chen-Harker-Kanzow-Smale equations"
    last = 1e-10

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=False)
        shadow = lifted.shadow
        shadow.smoothing = pyo.Param(mutable=True, initialize=self.first)
        sides = list(zip(lifted.firsts, lifted.seconds, strict=True))
        shadow.chks = pyo.Constraint(
            range(len(sides)),
            rule=lambda _, k: sides[k][0] + sides[k][1] - pyo.sqrt((sides[k][0] - sides[k][1]) ** 2 + 4 * shadow.smoothing) == 0,
        )

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.smoothing.value = eps


STRATEGY = Chks()
