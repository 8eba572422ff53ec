"""A scene as canonical text for hashes: equal scenes have equal text, other scenes other text."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import sympy as sp

from models.loading import loaded_sources
from models.scene import Scene

# Attribute with the text of a scene: no field, so that equality and `replace` ignore it.
_TEXT = "_text"


def scene_text(value: Any) -> str:
    """Return a scene, or a part of it, as text; the text of a scene is computed once.

    The text has every field by name, numbers in full, and SymPy expressions with their assumptions
    (srepr). User-defined functions in expressions are identified by their source.
    """
    if isinstance(value, Scene):
        if _TEXT not in vars(value):
            object.__setattr__(value, _TEXT, _text(value))
        return vars(value)[_TEXT]
    return _text(value)


def _text(value: Any) -> str:
    if is_dataclass(value) and not isinstance(value, type):
        inside = ", ".join(
            f"{field.name}={scene_text(getattr(value, field.name))}" for field in fields(value)
        )
        return f"{type(value).__name__}({inside})"
    if isinstance(value, sp.Basic):
        return sp.srepr(value) + _definitions(value)
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(scene_text(item) for item in value)}]"
    return repr(value)


# Digest of a class outside SymPy: of the file that was read when the class was first used, and of
# the file's imports.
_DIGESTS: WeakKeyDictionary[type, str] = WeakKeyDictionary()


def _definitions(expression: sp.Basic) -> str:
    """Return the text of user-defined functions, of which srepr has only the name.

    The meaning of such a function is in a file (undefined functions have no module).
    """
    classes = {type(part) for part in sp.preorder_traversal(expression)}
    own = sorted(
        (kind for kind in classes if kind.__module__ and not kind.__module__.startswith("sympy.")),
        key=lambda kind: kind.__qualname__,
    )
    return "".join(f" where {kind.__qualname__} is of {_digest(kind)}" for kind in own)


def _digest(kind: type) -> str:
    """Return the digest of the source of a class."""
    if kind not in _DIGESTS:
        file = getattr(sys.modules.get(kind.__module__), "__file__", None)
        _DIGESTS[kind] = loaded_sources() or (
            hashlib.sha256(Path(file).read_bytes()).hexdigest()
            if file is not None
            else kind.__module__
        )
    return _DIGESTS[kind]


def equations_text(scene: Scene) -> str:
    """Return the text of the equations alone.

    The text omits values of parameters, limits, drawings, and the task except its cost.
    """
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
