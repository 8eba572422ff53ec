"""The solver of the extra `[global]`; where it is missing one sentence says so."""

from __future__ import annotations

import importlib.util


def missing_solver() -> str | None:
    """None, or the sentence that says what is not installed and how to install it."""
    if importlib.util.find_spec("pyscipopt") is not None:
        return None
    return "a proof needs pyscipopt (SCIP, for mixed-integer programs); install with: pip install 'touchstone-contact[global]'."
