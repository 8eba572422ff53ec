"""A strategy: one way to make the pairs of a shadow smooth, steered by one number eps > 0 that goes to 0.

ONE FILE = ONE STRATEGY in formulations/mpec/strategies; the file defines `STRATEGY`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from formulations.mpec.lifted import Lifted


class Strategy(ABC):
    """name: as chosen by option; title: what it does, for people; first, last: where eps starts and ends unless the caller says otherwise;
    warm_below: from which eps on a step starts from the multipliers of the step before."""

    name: str
    title: str
    first: float = 1.0
    last: float = 1e-9
    warm_below: float = 1e-4

    @abstractmethod
    def attach(self, lifted: Lifted) -> None:
        """Write the relaxation into the shadow, once, before it is compiled."""

    @abstractmethod
    def set(self, lifted: Lifted, eps: float) -> None:
        """Move its mutable Param."""


def replace_objective(shadow: Any, penalty: Any) -> None:
    """Add a penalty (to be kept small) to whatever the user's objective is."""
    import pyomo.environ as pyo

    given = shadow.component("user_objective")
    if given is None:
        shadow.penalised = pyo.Objective(expr=penalty)
        return
    given.deactivate()
    sign = 1.0 if given.sense == pyo.minimize else -1.0
    shadow.penalised = pyo.Objective(expr=given.expr + sign * penalty, sense=given.sense)
