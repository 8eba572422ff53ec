"""Generated text, kept between processes: deriving and printing the equations of a large scene takes seconds, reading them back none.

kept_text(scene, "scene_model.h", lambda: emit_model(scene, defaults=False))
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import sympy as sp

from models.codegen.cache import cached
from models.scene import Scene
from models.scene_text import equations_text

_MODELS = Path(__file__).parents[1]
# Whatever decides the text beside the scene's own equations.
_GENERATORS = ("codegen/*.py", "contact*.py", "dynamics.py", "fmu/sensitivity.py", "fmu/structure.py", "fmu/variables.py")


def kept_text(scene: Scene, name: str, make: Callable[[], str]) -> str:
    """The text `name` of a scene: read from the cache folder, or made and kept there. It must depend on nothing but the scene's equations.

    Raises what `make` raises, and MachineError for a cache folder that cannot be written.
    """

    def write(path: Path) -> None:
        path.write_text(make(), encoding="utf-8")

    key = "\n".join([name, sp.__version__, _generators(), equations_text(scene)])
    return cached(key, f".{name}", write).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _generators() -> str:
    """Digest of the code that writes the text."""
    paths = sorted(path for pattern in _GENERATORS for path in _MODELS.glob(pattern))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()
