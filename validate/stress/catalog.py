"""Finds stress cases by file name and reads what they say of themselves, without importing them: some need PyTorch, some Pyomo."""

from __future__ import annotations

import ast
import difflib
import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import UnknownNameError

if TYPE_CHECKING:  # names cost no numpy
    from validate.stress.case import HardCase

FOLDER = Path(__file__).parent / "cases"


@dataclass(frozen=True, kw_only=True)
class CaseDescription:
    """The literals of a case's CASE = HardCase(...)."""

    name: str
    title: str
    expected: str
    quick: bool = False
    scenes: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """Number and title."""
        return f"{self.name[1:3]} {self.title}"


def case_names() -> tuple[str, ...]:
    """Names of all stress cases in the order of their numbers; reads file names only."""
    return tuple(sorted(path.stem for path in FOLDER.glob("h*.py")))


def describe_case(name: str) -> CaseDescription:
    """What a case says of itself. Raises UnknownNameError."""
    tree = ast.parse(_path(name).read_text(encoding="utf-8"))
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Call)
            and [ast.unparse(target) for target in node.targets] == ["CASE"]
        ):
            literals = {word.arg: ast.literal_eval(word.value) for word in node.value.keywords if word.arg and word.arg != "measure"}
            return CaseDescription(**literals)
    raise UnknownNameError(f"stress case file {name}.py: it must define CASE = HardCase(...) with literals for all but `measure`.")


def load_case(name: str) -> HardCase:
    """The case of that name. Raises UnknownNameError."""
    _path(name)
    case = importlib.import_module(f"validate.stress.cases.{name}").CASE
    if case.name != name:
        raise UnknownNameError(f"stress case file {name}.py: CASE.name is {case.name!r} but must equal the file's name.")
    return case


def _path(name: str) -> Path:
    if name not in case_names():
        close = difflib.get_close_matches(name, case_names(), n=1)
        raise UnknownNameError(
            f"there is no stress case {name!r}; " + (f"did you mean {close[0]}?" if close else f"there are {', '.join(case_names())}.")
        )
    return FOLDER / f"{name}.py"
