"""Finds methods by file name, and knows the pipelines. Nothing heavy is imported until a method is loaded."""

from __future__ import annotations

import difflib
import importlib
from pathlib import Path

from formulations.method import Method
from models.errors import UnknownNameError

_FOLDER = Path(__file__).parent / "methods"


def method_names() -> tuple[str, ...]:
    """Names of all methods, sorted; reads file names only."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.py") if not path.stem.startswith("_")))


def load_method(name: str) -> Method:
    """The method of that name. Raises UnknownNameError."""
    if name not in method_names():
        close = difflib.get_close_matches(name, method_names(), n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(method_names())}."
        raise UnknownNameError(f"there is no method {name!r}; {hint}")
    module = importlib.import_module(f"formulations.methods.{name}")
    method = module.METHOD
    if method.name != name:
        raise UnknownNameError(f"method file {name}.py: METHOD.name is {method.name!r} but must equal the file's name.")
    return method
