"""Catalog of stress cases, read without importing them: some need PyTorch or Pyomo."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import UnknownNameError, did_you_mean
from models.loading import declared

if TYPE_CHECKING:  # for type checkers only
    from validate.tasks.check import Found

FOLDER = Path(__file__).parent / "cases"


@dataclass(frozen=True, kw_only=True)
class StressCase:
    """Description of a case h<two digits>_<words>, which defines `CASE` of literals and `measure`.

    quick: run by a quick campaign; scenes, methods: used ones of the catalogs.
    """

    title: str
    expected: str
    quick: bool = False
    scenes: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()


def case_names() -> tuple[str, ...]:
    """Return the names of all stress cases in order; reads file names only."""
    return tuple(sorted(path.stem for path in FOLDER.glob("h*.py")))


def heading(name: str) -> str:
    """Return number and title of a case."""
    return f"{name[1:3]} {describe_case(name).title}"


def describe_case(name: str) -> StressCase:
    """Return a case's description. Raises UnknownNameError."""
    if name not in case_names():
        hint = did_you_mean(name, case_names(), f"there are {', '.join(case_names())}.")
        raise UnknownNameError(f"there is no stress case {name!r}; {hint}")
    return declared(FOLDER / f"{name}.py", "CASE", StressCase)


def load_case(name: str) -> Callable[[], Found]:
    """Return the case's `measure`."""
    return importlib.import_module(f"validate.stress.cases.{name}").measure
