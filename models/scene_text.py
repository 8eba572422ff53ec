"""A scene as canonical text, of which hashes are made: equal scenes, equal text; anything else, another text."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import sympy as sp

from models.scene import Scene

# Where a scene keeps its text: no field, so that neither equality nor `replace` see it.
_TEXT = "_text"


def scene_text(value: Any) -> str:
    """Every field by name, SymPy expressions with their assumptions (srepr), numbers in full; of a scene, which cannot change, made once."""
    if isinstance(value, Scene):
        if _TEXT not in vars(value):
            object.__setattr__(value, _TEXT, _text(value))
        return vars(value)[_TEXT]
    return _text(value)


def _text(value: Any) -> str:
    if is_dataclass(value) and not isinstance(value, type):
        inside = ", ".join(f"{field.name}={scene_text(getattr(value, field.name))}" for field in fields(value))
        return f"{type(value).__name__}({inside})"
    if isinstance(value, sp.Basic):
        return sp.srepr(value)
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(scene_text(item) for item in value)}]"
    return repr(value)


def equations_text(scene: Scene) -> str:
    """What the equations are made of, and nothing else: neither values of parameters, nor the task but for its cost, nor limits and drawings."""
    return scene_text(
        [
            scene.name,
            [(coordinate.symbol, coordinate.velocity) for coordinate in scene.coordinates],
            [item.symbol for item in scene.inputs],
            [parameter.symbol for parameter in scene.parameters],
            [scene.kinetic_energy, scene.potential_energy, scene.forces],
            [scene.contacts, scene.frictions, scene.length],
            [scene.task.running_cost, scene.task.final_cost],
        ]
    )
