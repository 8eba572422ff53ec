"""The problems that are written down: each file adds its own, by the decorator `problem`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pyomo.environ as pyo

# Name -> what builds its model, and the optimum published in MacMPEC's index (S. Leyffer).
PROBLEMS: dict[str, tuple[Callable[[], pyo.ConcreteModel], float]] = {}


def problem(
    optimum: float, name: str = "", *arguments: Any
) -> Callable[[Callable[..., None]], Callable[[], pyo.ConcreteModel]]:
    """Of a function that writes a problem into an empty model, given `arguments` too: what builds it, kept under `name` or the function's own."""

    def kept(write: Callable[..., None]) -> Callable[[], pyo.ConcreteModel]:
        def build() -> pyo.ConcreteModel:
            m = pyo.ConcreteModel()
            write(m, *arguments)
            return m

        PROBLEMS[name or write.__name__] = build, optimum
        return build

    return kept
