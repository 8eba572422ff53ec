"""v w <= 0 at once: what an NLP solver makes of the problem as it stands."""

from __future__ import annotations

from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy


class Direct(Strategy):
    name = "direct"
    title = "products at most 0, in one solve"
    first = last = 1e-8  # Ipopt's own tolerance: a bound of 0 would leave its iterates no interior at all

    def attach(self, lifted: Lifted) -> None:
        lifted.products(active=True)

    def set(self, lifted: Lifted, eps: float) -> None:
        lifted.shadow.mpec_bound.value = eps


STRATEGY = Direct()
