"""Cache texts generated from a scene's equations between processes.

    cached_text(scene, "scene_model.h", lambda: emit_model(scene))

Deriving and printing the equations of a large scene takes seconds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import sympy as sp

from models.codegen.cache import cached
from models.scene import Scene
from models.scene.text import equations_text

_MODELS = Path(__file__).parents[1]
# Sources that decide the text, besides the scene's equations.
_GENERATORS = (
    "codegen/*.py",
    "contact*.py",
    "dynamics.py",
    "fmu/sensitivity.py",
    "fmu/structure.py",
    "fmu/variables.py",
)
# Those of an FMU: all but the scenes, whose text is in the key.
_ALL = ("*.py", "codegen/*.*", "fmu/**/*.*")


def cached_text(scene: Scene, name: str, make: Callable[[], str]) -> str:
    """Return the text `name` of a scene from the cache, or make and store it.

    `make` may depend on the scene's equations only. Raises MachineError if the cache folder is not
    writable, and the errors of `make`.
    """
    key = "\n".join([name, sp.__version__, _generators(), equations_text(scene)])
    return cached(
        key, f".{name}", lambda path: path.write_text(make(), encoding="utf-8")
    ).read_text(encoding="utf-8")


def generators() -> str:
    """Return SymPy's version and a digest of models, the rest of an FMU's key."""
    return "\n".join([sp.__version__, _generators(_ALL)])


@lru_cache(maxsize=2)
def _generators(patterns: tuple[str, ...] = _GENERATORS) -> str:
    paths = sorted(
        path for pattern in patterns for path in _MODELS.glob(pattern) if path.suffix != ".pyc"
    )
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()
