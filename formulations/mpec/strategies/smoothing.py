"""v + w = sqrt(v^2 + w^2 + 2 eps) (Fischer-Burmeister, smoothed by Kanzow): v w = eps at every point of the path, and v, w > 0."""

from __future__ import annotations

import pyomo.environ as pyo

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy


class Smoothing(Strategy):
    name = "smoothing"
    title = "smoothed Fischer-Burmeister equations"
    last = 1e-10

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=False)
        shadow = lifted.shadow
        shadow.smoothing = pyo.Param(mutable=True, initialize=self.first)
        sides = list(zip(lifted.firsts, lifted.seconds, strict=True))
        shadow.fischer = pyo.Constraint(
            range(len(sides)),
            rule=lambda _, k: sides[k][0] + sides[k][1] - pyo.sqrt(sides[k][0] ** 2 + sides[k][1] ** 2 + 2 * shadow.smoothing) == 0,
        )

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.smoothing.value = eps


STRATEGY = Smoothing()
