"""A scene as canonical text, of which hashes are made: equal scenes, equal text.

Anything else, another text.
"""

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

# Where a scene keeps its text: no field, so that neither equality nor `replace` see it.
_TEXT = "_text"


def scene_text(value: Any) -> str:
    """A scene, or a part of it, as text; of a scene, which cannot change, made once.

    Every field by name, numbers in full, SymPy expressions with their assumptions (srepr) and where
    somebody's own functions in them are from.
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


# What a class that is not SymPy's is made of: the digest of the file that was read when it was
# first met, and of what that imports.
_DIGESTS: WeakKeyDictionary[type, str] = WeakKeyDictionary()


def _definitions(expression: sp.Basic) -> str:
    """What srepr leaves out: somebody's own functions have a name there, and their meaning in a file (undefined ones have no module)."""
    classes = {type(part) for part in sp.preorder_traversal(expression)}
    own = sorted(
        (kind for kind in classes if kind.__module__ and not kind.__module__.startswith("sympy.")),
        key=lambda kind: kind.__qualname__,
    )
    return "".join(f" where {kind.__qualname__} is of {_digest(kind)}" for kind in own)


def _digest(kind: type) -> str:
    """Digest of where a class is from."""
    if kind not in _DIGESTS:
        file = getattr(sys.modules.get(kind.__module__), "__file__", None)
        _DIGESTS[kind] = loaded_sources() or (
            hashlib.sha256(Path(file).read_bytes()).hexdigest()
            if file is not None
            else kind.__module__
        )
    return _DIGESTS[kind]


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
