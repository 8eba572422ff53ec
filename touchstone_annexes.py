"""Find annexes: folders of touchstone that can be removed without a change of the core.

    ENTRIES = {"check": "validate.cli.check"}
    present(ENTRIES)  # the entries whose module is in this installation
    load("validate.tasks.fmu_checks:checks")

The core names an annex only in such tables, never in an import. docs/architecture.md lists the
annexes and their tables.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parent


def is_present(reference: str) -> bool:
    """Return whether the file of a reference, `module` or `module:name`, exists.

    The module's packages are not imported.
    """
    place = _ROOT.joinpath(*reference.partition(":")[0].split("."))
    return place.with_name(f"{place.name}.py").is_file() or (place / "__init__.py").is_file()


def present(table: Mapping[str, str]) -> dict[str, str]:
    """Return the entries of a table, name to reference, whose module exists."""
    return {name: reference for name, reference in table.items() if is_present(reference)}


def load(reference: str) -> Any:
    """Import and return `module:name`."""
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
