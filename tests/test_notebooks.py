"""The notebooks of docs/examples run as they stand, and show what they say.

Their cells are executed here, in one namespace, and the last expression of each is displayed as a
notebook would: no kernel in another process, whose start takes longer than most of them, and an
error is a plain traceback.
"""

import ast
import json
import os
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "examples"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
# What the reader is promised to see, by the names in the notebook.
SEEN = {
    "judge_your_plan": lambda space: (
        space["verdict"].verdict.value == "violates" and space["metrics"].ok.eq(False).any()
    ),
    "extend_the_pyomo_model": lambda space: (
        space["second"] > space["first"] and not space["relaxed"].holds and space["verdict"].holds
    ),
    "solve_an_mpec": lambda space: (
        space["certificate"].holds
        and abs(space["model"].y.value - 2.0) < 1e-6
        and space["pushed"] > 0.01
    ),
    "compare_methods": lambda space: (
        list(space["table"].verdict) == ["violates", "violates", "holds", "holds"]
    ),
}


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    return [
        cell
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == kind
    ]


def run(source: str, space: dict[str, Any], name: str) -> Any:
    """Execute a cell; the value of its last expression, or None."""
    tree = ast.parse(source, name)
    last = ast.Expression(tree.body.pop().value) if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, name, "exec"), space)
    return None if last is None else eval(compile(last, name, "eval"), space)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_it_says(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    space: dict[str, Any] = {}
    for place, cell in enumerate(cells(path, "code")):
        shown = run("".join(cell["source"]), space, f"{path.name}, cell {place}")
        if hasattr(shown, "_repr_html_"):
            assert len(shown._repr_html_().encode()) <= 150_000
    pyplot.close("all")
    assert SEEN[path.stem](space)
    assert os.listdir(tmp_path) == [], "it leaves nothing behind"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_short_and_has_no_outputs(path: Path):
    """Its outputs would be somebody's machine; what is to be seen stands in words."""
    code = cells(path, "code")
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)
    assert sum(bool(line.strip()) for cell in code for line in cell["source"]) < 80
    words = "".join("".join(cell["source"]) for cell in cells(path, "markdown"))
    assert "**You should see**" in words
    assert "**Change something**" in words
    assert "".join(cells(path, "markdown")[-1]["source"]).count("**Change something**") == 1


def test_every_notebook_is_told_of():
    assert {path.stem for path in NOTEBOOKS} == set(SEEN)
    listed = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(f"({path.name})" in listed for path in NOTEBOOKS)
