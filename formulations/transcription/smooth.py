"""Which functions of SymPy have a form in Pyomo. Light to import: no Pyomo."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import sympy as sp

from models.errors import SceneError
from models.scene import Scene

SMOOTH = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log", "sqrt")


def check_smooth(scene: Scene, what: str, expressions: Iterable[Any]) -> None:
    """Raises SceneError for a function that Pyomo does not have (erf, atan2 ..); scenes have none with corners (models.scene.functions)."""
    for expression in expressions:
        for call in sp.sympify(expression).atoms(sp.Function):
            if call.func.__name__ not in SMOOTH:
                raise SceneError(
                    f"scene {scene.name}: {what} contains {call}, which has no form in Pyomo; use {', '.join(SMOOTH)} and powers."
                )
