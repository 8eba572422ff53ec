"""Load scenes: those of this package by name, a user's by path.

    load_scene("three_cart")
    load_scene("my/own_scene.py")

A scene file defines `SCENE`, whose name equals the file's name.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import SceneError, TouchstoneError, UnknownNameError, did_you_mean, nearest

if TYPE_CHECKING:
    from models.scene import Scene

_FOLDER = Path(__file__).parent / "scenes"
# Files that are given for a scene by mistake.
_OTHERS = {
    ".csv": "a plan, which stands before --scene",
    ".nc": "a plan, which stands before --scene",
    ".fmu": "an FMU, which --fmu takes",
    ".toml": "a map (--map) or a campaign (run)",
    ".xml": "a robot, which `fmu --mjcf` takes",
}


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
    if Path(f"{reference}.py").is_file():
        raise UnknownNameError(f"there is no scene {reference!r}; did you mean {reference}.py?")
    if Path(reference).suffix in _OTHERS:
        raise UnknownNameError(
            f"there is no scene {reference!r}: this is {_OTHERS[Path(reference).suffix]}; "
            "a scene is given by its name or by the path of its .py file."
        )
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
                f"scene file {path}: {type(error).__name__} while it was read{_line_of(error, path)}: {_advised(error)}"
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


# Words of an error that Python or SymPy raises, and what to do.
_ADVICE = {
    "loop of ufunc does not support argument": "use SymPy's function, such as sp.sin, not NumPy's",
    "Cannot convert expression to float": "use SymPy's function, such as sp.sin, not that of math",
    "truth value of Relational": "an `if` cannot ask for a symbol's value; write a Contact, or weigh both cases",
}


def _advised(error: BaseException) -> str:
    """Return the text of what a scene file raised, with advice for a beginner's mistakes."""
    import models.scene

    text = str(error)
    wanted = re.match(r"cannot import name '(\w+)' from 'models.scene'", text)
    if wanted is not None:
        known = models.scene.__all__
        advice = did_you_mean(wanted[1], known, f"it has {', '.join(known)}.")
        return f"models.scene has no {wanted[1]}; {advice}"
    if isinstance(error, ModuleNotFoundError) and nearest(
        str(error.name).partition(".")[0], ("models", "touchstone", "scene")
    ):
        return f"{text}; the parts of a scene are imported from models.scene"
    if isinstance(error, NameError) and error.name:
        return f"{text}; declare it, as {error.name} = sp.Symbol({error.name!r}, real=True), or import it"
    advice = next((words for part, words in _ADVICE.items() if part in text), None)
    return text if advice is None else f"{text}; {advice}"


def _line_of(error: BaseException, path: Path) -> str:
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == str(path)
    ]
    return f", line {lines[-1]}" if lines else ""
