"""Writes docs/scene_reference.md: every field of a scene, from the docstrings of models/scene.

python docs/site/scene_reference.py

A test checks that the page is up to date and runs its examples (tests/test_scene_reference.py).
"""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import models.scene
from models.scene import functions

PAGE = Path(__file__).parents[1] / "scene_reference.md"
EXAMPLES = Path(__file__).with_name("scene_examples.txt")
CLASSES = (
    "Scene",
    "Task",
    "Coordinate",
    "Input",
    "Parameter",
    "Contact",
    "Friction",
    "Limit",
    "Shape",
    "Answer",
)
# Fields that a user never sets.
HIDDEN = ("lag",)
_TYPES = {
    "sp.Expr": "expression",
    "sp.Symbol": "symbol",
    "float": "number",
    "int": "whole number",
    "str": "text",
    "bool": "True or False",
}
_LONGEST = 40


def page() -> str:
    """Return the whole page."""
    introduction, _, recipes = EXAMPLES.read_text(encoding="utf-8").partition("<!-- fields -->\n")
    values = example_values(introduction + recipes)
    names = ", ".join(sorted(models.scene.__all__))
    tables = "\n".join(_class(name, values) for name in CLASSES)
    return (
        introduction.replace("NAMES", names)
        + f"## Fields\n\n{tables}\n"
        + recipes.replace("FUNCTIONS", _functions())
    )


def example_values(text: str) -> dict[tuple[str, str], str]:
    """Return the first value that the examples give to each field, by class and field."""
    found: dict[tuple[str, str], str] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        for call in ast.walk(ast.parse(block)):
            name = (
                call.func.id
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
                else ""
            )
            # replace(SCENE, ..) gives fields of Scene, replace(SCENE.task, ..) those of Task.
            if name == "replace":
                name = {"SCENE": "Scene", "SCENE.task": "Task"}.get(ast.unparse(call.args[0]), "")  # type: ignore[attr-defined]
            for keyword in call.keywords if isinstance(call, ast.Call) else ():
                found.setdefault((name, str(keyword.arg)), _short(keyword.value))
    return found


def _short(value: ast.expr) -> str:
    """Return the source of a value; of a long one only its shape."""
    text = ast.unparse(value)
    if len(text) <= _LONGEST:
        return text
    if isinstance(value, ast.Call):
        return f"{ast.unparse(value.func)}(..)"
    if isinstance(value, ast.Tuple) and len(value.elts) == 1:
        return f"({_short(value.elts[0])},)"
    if isinstance(value, ast.Tuple):
        return f"({_short(value.elts[0])}, ..)"
    return f"{text[: _LONGEST - 3]}.."


def meanings(kind: type) -> dict[str, str]:
    """Return the meaning of each field, from the section Attributes of the docstring."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")
    found: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        if line and not line.startswith(" "):
            name = line.strip()
            found[name] = ""
        elif line.strip():
            found[name] = f"{found[name]} {line.strip()}".strip()
    return found


def _class(name: str, values: dict[tuple[str, str], str]) -> str:
    kind: Any = getattr(models.scene, name)
    said = meanings(kind)
    first = (inspect.getdoc(kind) or "").splitlines()[0]
    rows = ["| field | type | default | unit | meaning | example |", "|---|---|---|---|---|---|"]
    for field in fields(kind):
        if field.name in HIDDEN:
            continue
        must = field.default is MISSING or said[field.name].endswith("; must be given.")
        default = "required" if must else f"`{_default(field.default)}`"
        # The first unit in brackets has a column of its own.
        unit = re.search(r" \[([^\]]+)\]", said[field.name])
        meaning = said[field.name].replace("; must be given", "")
        meaning = meaning.replace(unit[0], "", 1) if unit else meaning
        cells = [
            f"`{field.name}`",
            _type(str(field.type)),
            default,
            unit[1] if unit else "",
            meaning,
            f"`{values[name, field.name]}`",
        ]
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return f"### {name}\n\n{first}\n\n" + "\n".join(rows) + "\n"


def _default(value: Any) -> str:
    return str(value) if not isinstance(value, str) else repr(value)


def _type(annotation: str) -> str:
    for python, words in _TYPES.items():
        annotation = re.sub(rf"\b{re.escape(python)}\b", words, annotation)
    return annotation.replace(" | ", " or ").replace(", ...", ", ..")


def _functions() -> str:
    usable = ", ".join(f"`{function.__name__}`" for function in functions.FUNCTIONS)
    rows = "\n".join(
        f"| `{function.__name__}` | {advice} |" for function, advice in functions.ROUNDED.items()
    )
    return (
        f"`+ - * / **`, `sqrt`, {usable}. Plans need derivatives, so functions with corners or jumps are refused:\n\n"
        f"| not | write instead (r: radius of the rounding, a parameter) |\n|---|---|\n{rows}"
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
