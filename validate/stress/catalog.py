"""Finds stress cases by file name and reads what they say of themselves, without importing them: some need PyTorch, some Pyomo."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import UnknownNameError, did_you_mean
from models.loading import declared

if TYPE_CHECKING:  # names cost no numpy
    from validate.tasks.check import Found

FOLDER = Path(__file__).parent / "cases"


@dataclass(frozen=True, kw_only=True)
class StressCase:
    """What a case says of itself.

    Its file is called h<two digits>_<words> and defines `CASE`, whose arguments are literals, and
    `measure`.

    quick: whether a quick campaign runs it; scenes, methods: names of those of the catalogs it
        uses, on which a stored result depends.
    """

    title: str
    expected: str
    quick: bool = False
    scenes: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()


def case_names() -> tuple[str, ...]:
    """Names of all stress cases in the order of their numbers; reads file names only."""
    return tuple(sorted(path.stem for path in FOLDER.glob("h*.py")))


def heading(name: str) -> str:
    """Number and title of a case."""
    return f"{name[1:3]} {describe_case(name).title}"


def describe_case(name: str) -> StressCase:
    """What a case says of itself. Raises UnknownNameError."""
    if name not in case_names():
        hint = did_you_mean(name, case_names(), f"there are {', '.join(case_names())}.")
        raise UnknownNameError(f"there is no stress case {name!r}; {hint}")
    return declared(FOLDER / f"{name}.py", "CASE", StressCase)


def load_case(name: str) -> Callable[[], Found]:
    """What measures the case of that name."""
    return importlib.import_module(f"validate.stress.cases.{name}").measure
