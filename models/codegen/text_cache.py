"""Generated text, cached between processes: deriving and printing the equations of a large scene takes seconds, reading them back none.

cached_text(scene, "scene_model.h", lambda: emit_model(scene))
# of the values and the task, too
cached_text(scene, "reference.csv", lambda: motion_as_text(scene), whole=True)
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import sympy as sp

from models.codegen.cache import cached
from models.scene import Scene
from models.scene.text import equations_text, scene_text

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
# And of a text that is computed from its values.
_COMPUTED = ("fmu/description.py", "fmu/reference.py", "scene/*.py")
# And of an FMU: all but the scenes, whose text is in the key.
_ALL = ("*.py", "codegen/*.*", "fmu/**/*.*")
_LIBRARIES = ("numpy", "scipy")


def cached_text(scene: Scene, name: str, make: Callable[[], str], *, whole: bool = False) -> str:
    """The text `name` of a scene: read from the cache folder, or made and stored there.

    Parameters
    ----------
    make
        Makes the text; it must depend on nothing but the scene's equations.
    whole
        Whether it may depend on all of the scene.

    Returns
    -------
    str
        The text.

    Raises
    ------
    MachineError
        For a cache folder that cannot be written; and what `make` raises.
    """
    if whole:
        content = [*_versions(), _generators((*_GENERATORS, *_COMPUTED)), scene_text(scene)]
    else:
        content = [_generators(), equations_text(scene)]
    key = "\n".join([name, sp.__version__, *content])
    return cached(
        key, f".{name}", lambda path: path.write_text(make(), encoding="utf-8")
    ).read_text(encoding="utf-8")


def generators(*, whole: bool = False) -> str:
    """What decides an FMU beside its scene, compiler and headers: the code of the models and of SymPy; whole: and what computes numbers for it."""
    return "\n".join([sp.__version__, *(_versions() if whole else ()), _generators(_ALL)])


def _versions() -> list[str]:
    from importlib import metadata  # 10 ms to import

    return [metadata.version(library) for library in _LIBRARIES]


@lru_cache(maxsize=3)
def _generators(patterns: tuple[str, ...] = _GENERATORS) -> str:
    """Digest of the code that writes the text."""
    paths = sorted(
        path for pattern in patterns for path in _MODELS.glob(pattern) if path.suffix != ".pyc"
    )
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()
