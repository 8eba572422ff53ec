"""A folder of things built once, content-addressed, so that it never needs cleaning to be right; and the texts of scenes in it.

    cached(key_text, ".so", build)                                                      # a file, found or built
    cached_text(scene, "scene_model.h", lambda: emit_model(scene, defaults=False))      # deriving and printing it takes seconds, reading it back none
    cached_text(scene, "reference.csv", lambda: motion_as_text(scene), whole=True)      # of the values and the task, too

The folder is $TOUCHSTONE_CACHE, or `touchstone` in the user's cache folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import sympy as sp

from models.errors import MachineError
from models.scene import Scene
from models.scene.text import equations_text, scene_text

# What is being built, and by whom: building-<process>-<host>-<random>.
_BUILDING = "building-"


def _place() -> Path:
    given = os.environ.get("TOUCHSTONE_CACHE")
    if given:
        return Path(given).absolute()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "touchstone"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "touchstone"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchstone"


def cache_folder() -> Path:
    """The cache folder, created if needed. Raises MachineError if it cannot be written."""
    folder = _place()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MachineError(
            f"the cache folder {folder} cannot be created ({error.strerror}); set TOUCHSTONE_CACHE to a folder you can write."
        ) from error
    if not os.access(folder, os.W_OK):
        raise MachineError(f"the cache folder {folder} cannot be written; set TOUCHSTONE_CACHE to a folder you can write.")
    return folder


def _remove_what_the_dead_left(folder: Path) -> None:
    """Of processes of this machine alone: those of another cannot be looked up here."""
    import psutil

    for left in folder.glob(f"{_BUILDING}*"):
        number, _, rest = left.name.removeprefix(_BUILDING).partition("-")
        if rest.rpartition("-")[0] == socket.gethostname() and number.isdigit() and not psutil.pid_exists(int(number)):
            shutil.rmtree(left, ignore_errors=True)


def cached(key_text: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """The file for this content: found, be it in a folder that cannot be written, or made by `build(path)` in a temporary place and renamed.

    Two processes may build the same file at once; both end with a whole one. What a process left that was killed while it built goes with
    the next one that builds. Raises MachineError when the disk refuses.
    """
    key = hashlib.sha256(key_text.encode()).hexdigest()
    target = _place() / f"{key[:32]}{suffix}"
    if target.exists():
        return target
    cache_folder()
    _remove_what_the_dead_left(target.parent)
    try:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f"{_BUILDING}{os.getpid()}-{socket.gethostname()}-") as folder:
            made = Path(folder) / target.name
            build(made)
            os.replace(made, target)
    except OSError as error:
        raise MachineError(
            f"the cache folder {target.parent} cannot be written ({error}); set TOUCHSTONE_CACHE to another folder."
        ) from error
    return target


_MODELS = Path(__file__).parents[1]
# Whatever decides the text beside the scene's own equations.
_GENERATORS = ("codegen/*.py", "contact*.py", "dynamics.py", "fmu/sensitivity.py", "fmu/structure.py", "fmu/variables.py")
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

    def write(path: Path) -> None:
        path.write_text(make(), encoding="utf-8")

    if whole:
        content = [*_versions(), _generators((*_GENERATORS, *_COMPUTED)), scene_text(scene)]
    else:
        content = [_generators(), equations_text(scene)]
    key = "\n".join([name, sp.__version__, *content])
    return cached(key, f".{name}", write).read_text(encoding="utf-8")


def generators(*, whole: bool = False) -> str:
    """What decides an FMU beside its scene, compiler and headers: the code of the models and of SymPy; whole: and what computes numbers for it."""
    return "\n".join([sp.__version__, *(_versions() if whole else ()), _generators(_ALL)])


def _versions() -> list[str]:
    from importlib import metadata  # 10 ms to import

    return [metadata.version(library) for library in _LIBRARIES]


@lru_cache(maxsize=3)
def _generators(patterns: tuple[str, ...] = _GENERATORS) -> str:
    """Digest of the code that writes the text."""
    paths = sorted(path for pattern in patterns for path in _MODELS.glob(pattern) if path.suffix != ".pyc")
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()
