"""Load scenes: those of this package by name, a user's by path.

    load_scene("three_cart")
    load_scene("my/own_scene.py")

A scene file defines `SCENE`, whose name equals the file's name.
"""

from __future__ import annotations

import importlib.util
import sys
import traceback
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import SceneError, TouchstoneError, UnknownNameError, did_you_mean

if TYPE_CHECKING:
    from models.scene import Scene

_FOLDER = Path(__file__).parent / "scenes"


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes of this package, sorted, from file names."""
    return tuple(
        sorted(path.stem for path in _FOLDER.glob("*.py") if not path.stem.startswith("_"))
    )


def scene_path(reference: str) -> Path:
    """Return the file of a scene given by name or by path to a .py file.

    Raises UnknownNameError, SceneError.
    """
    if reference.endswith(".py"):
        path = Path(reference)
        if not path.is_file():
            raise SceneError(f"scene file {reference}: there is no such file.")
        return path.resolve()
    if reference in scene_names():
        return _FOLDER / f"{reference}.py"
    what = f"there are {', '.join(scene_names())}; a scene of your own is given by the path of its .py file."
    raise UnknownNameError(
        f"there is no scene {reference!r}; {did_you_mean(reference, scene_names(), what)}"
    )


def as_scene(scene: Scene | str | Path) -> Scene:
    """Return a scene given as a scene, name or file; raise UnknownNameError or SceneError."""
    from models.scene import Scene

    if isinstance(scene, (str, Path)):
        return load_scene(str(scene))
    if not isinstance(scene, Scene):
        raise SceneError(
            f"scene: a {type(scene).__name__} is no scene; give the name of one, the path of its file or a Scene."
        )
    return scene


def load_scene(reference: str) -> Scene:
    """Load a scene by name or file; raise UnknownNameError or SceneError, naming the file."""
    from models.loading import Afresh, loading
    from models.scene import Scene
    from models.scene.checks import check_expressions, step_problem
    from models.scene.text import scene_text

    path = scene_path(reference)
    is_builtin = path.parent == _FOLDER
    module_name = f"models.scenes.{path.stem}" if is_builtin else f"_touchstone_scene_{path.stem}"
    if is_builtin and module_name in sys.modules:
        module = sys.modules[module_name]
    else:
        loader = None if is_builtin else Afresh(module_name, str(path))
        spec = importlib.util.spec_from_file_location(module_name, path, loader=loader)
        if spec is None or spec.loader is None:
            raise SceneError(f"scene file {path}: it cannot be read as Python.")
        module = importlib.util.module_from_spec(spec)
        try:
            with nullcontext() if is_builtin else loading(path):
                spec.loader.exec_module(module)
                if isinstance(getattr(module, "SCENE", None), Scene):
                    check_expressions(module.SCENE)
                    # Stored now: the sources of the scene's functions are known only during
                    # execution.
                    scene_text(module.SCENE)
        except TouchstoneError as error:
            raise SceneError(f"scene file {path}{_line_of(error, path)}: {error}") from error
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a file may raise anything
            raise SceneError(
                f"scene file {path}: {type(error).__name__} while it was read{_line_of(error, path)}: {error}"
            ) from error
        problem = step_problem(path.read_bytes())
        if problem is not None:
            raise SceneError(
                f"scene file {path}, line {problem[0]}: scene {path.stem}: {problem[1]}"
            )
        if is_builtin:
            sys.modules[module_name] = module
    scene = getattr(module, "SCENE", None)
    if not isinstance(scene, Scene):
        content = f"found {type(scene).__name__}" if hasattr(module, "SCENE") else "there is none"
        raise SceneError(
            f"scene file {path}: it must define SCENE, a models.scene.Scene; {content}."
        )
    if scene.name != path.stem:
        raise SceneError(
            f"scene file {path}: SCENE.name is {scene.name!r} but must equal the file's name {path.stem!r}."
        )
    return scene


def _line_of(error: BaseException, path: Path) -> str:
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == str(path)
    ]
    return f", line {lines[-1]}" if lines else ""
