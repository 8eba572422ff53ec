"""v w <= eps (Scholtes): Pyomo's own `mpec.simple_nonlinear`, whose mutable bound goes to 0."""

from __future__ import annotations

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy


class Scholtes(Strategy):
    name = "scholtes"
    title = "products at most eps, eps to 0"

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=True)

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.mpec_bound.value = eps


STRATEGY = Scholtes()
