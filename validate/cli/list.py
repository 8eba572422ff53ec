"""`list`: print scenes, pipelines, methods and stress cases.

Titles are the first lines of the files' docstrings, so that nothing is imported.
"""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import click

from formulations.pipelines import PIPELINES, QUICK, method_names
from models.catalog import scene_names, scene_path
from validate.cli.table import one_line, table, wide_option
from validate.stress.catalog import case_names, describe_case

# The docstring of a file, after comments.
_DOCSTRING = re.compile(r"""(?:\s|#[^\n]*\n)*([rRuU]?(\"{3}|'{3}|"|').*?(?<!\\)\2)""", re.DOTALL)


@click.command(
    epilog="""\b
Examples:
  python -m validate list
  python -m validate list --json

Exit codes: 0 listed; 2 usage.
"""
)
@click.option("--json", "as_json", is_flag=True, help="Print the lists as JSON.")
@wide_option
def command(as_json: bool) -> int:
    """List scenes, pipelines, methods and stress cases."""
    cases = [(name, describe_case(name)) for name in case_names()]
    methods = Path(__file__).resolve().parents[2] / "formulations" / "methods"
    data = {
        "scenes": [{"name": name, "title": _title(scene_path(name))} for name in scene_names()],
        "pipelines": [
            {
                "name": pipeline.name,
                "title": pipeline.title,
                "quick": pipeline.name in QUICK,
                "stages": [
                    {"method": leg.method, "eps": list(leg.schedule)} for leg in pipeline.legs
                ],
            }
            for pipeline in PIPELINES
        ],
        "methods": [
            {"name": name, "title": _title(methods / f"{name}.py")} for name in method_names()
        ],
        "stress cases": [
            {"name": name, "title": case.title, "quick": case.quick, "expected": case.expected}
            for name, case in cases
        ],
    }
    if as_json:
        click.echo(json.dumps(data, indent=1))
        return 0
    click.echo(
        table(["scene", "what it is"], [[item["name"], item["title"]] for item in data["scenes"]])
    )
    click.echo()
    rows = [
        [item["name"], "quick" if item["quick"] else "", _stages(item["stages"]), item["title"]]
        for item in data["pipelines"]
    ]
    click.echo(
        table(
            ["pipeline", "", "stages (method: eps)", "what it is"],
            rows,
            drop=("stages (method: eps)",),
        )
    )
    click.echo()
    click.echo(
        table(["method", "what it is"], [[item["name"], item["title"]] for item in data["methods"]])
    )
    click.echo()
    told = [
        [item["name"], "quick" if item["quick"] else "", item["title"]]
        for item in data["stress cases"]
    ]
    click.echo(table(["stress case", "", "what it is"], told))
    return 0


def _stages(legs: list[dict]) -> str:
    parts = []
    for leg in legs:
        schedule = ", ".join(f"{eps:g}" for eps in leg["eps"] if eps is not None)
        parts.append(f"{leg['method']}: {schedule}" if schedule else leg["method"])
    return " -> ".join(parts)


def _title(path: Path) -> str:
    """Return the first sentence of a file's docstring, found by a pattern.

    Parsing all files takes 20 ms, and importing `tokenize` 6 ms.
    """
    try:
        found = _DOCSTRING.match(path.read_text(encoding="utf-8"))
        words = ast.literal_eval(found[1]) if found else ""
    except (OSError, SyntaxError, UnicodeDecodeError) as error:
        return f"(cannot be read: {type(error).__name__})"
    return one_line(words.split("\n\n")[0])
