"""The solvers of the extra `[global]`, imported where they are used; what is missing is said in one sentence."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from models.errors import MachineError

_SOLVERS = {"pyscipopt": "SCIP, for mixed-integer programs", "clarabel": "Clarabel, for convex programs"}


def missing_solvers() -> str | None:
    """None, or the sentence that says what is not installed and how to install it."""
    absent = [f"{name} ({what})" for name, what in _SOLVERS.items() if importlib.util.find_spec(name) is None]
    if not absent:
        return None
    return f"a proof needs {' and '.join(absent)}; install with: pip install 'touchstone-contact[global]'."


def solver(name: str) -> Any:
    """The module of that name. Raises MachineError."""
    if importlib.util.find_spec(name) is None:
        raise MachineError(missing_solvers() or f"a proof needs {name}.")
    return importlib.import_module(name)
