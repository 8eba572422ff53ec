"""Texts that are generated from a scene's equations, cached between processes.

    cached_text(scene, "scene_model.h", lambda: emit_model(scene))

Deriving and printing the equations of a large scene takes seconds; reading the text takes none.
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
# Whatever decides the text beside the scene's own equations.
_GENERATORS = (
    "codegen/*.py",
    "contact*.py",
    "dynamics.py",
    "fmu/sensitivity.py",
    "fmu/structure.py",
    "fmu/variables.py",
)
# And of an FMU: all but the scenes, whose text is in the key.
_ALL = ("*.py", "codegen/*.*", "fmu/**/*.*")


def cached_text(scene: Scene, name: str, make: Callable[[], str]) -> str:
    """The text `name` of a scene: read from the cache folder, or made and stored there.

    Parameters
    ----------
    make
        Makes the text; it must depend on nothing but the scene's equations.

    Returns
    -------
    str
        The text.

    Raises
    ------
    MachineError
        For a cache folder that cannot be written; and what `make` raises.
    """
    key = "\n".join([name, sp.__version__, _generators(), equations_text(scene)])
    return cached(
        key, f".{name}", lambda path: path.write_text(make(), encoding="utf-8")
    ).read_text(encoding="utf-8")


def generators() -> str:
    """Return the parts of an FMU's key beside its scene, compiler and headers: SymPy's version and a digest of models."""
    return "\n".join([sp.__version__, _generators(_ALL)])


@lru_cache(maxsize=2)
def _generators(patterns: tuple[str, ...] = _GENERATORS) -> str:
    """Digest of the code that writes the text."""
    paths = sorted(
        path for pattern in patterns for path in _MODELS.glob(pattern) if path.suffix != ".pyc"
    )
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()
