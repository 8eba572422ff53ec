"""What the README prints runs as printed."""

import re
from pathlib import Path

import pytest

from benchmarks.golden import results_table
from models.catalog import load_scene
from models.trajectory import column_names
from validate.cli.group import run

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


# The last number each snippet prints: the replay error [m] of the solved plan; the cost of softplus
# collocation with a row that binds (197.86 without); y of the nearest point (0, 2).
@pytest.mark.parametrize(
    ("snippet", "printed"), list(zip(SNIPPETS, (6.8386e-3, 205.04, 2.0), strict=True))
)
def test_a_snippet_runs(snippet: str, printed: float, capsys):
    exec(compile(snippet, "README.md", "exec"), {})
    assert float(capsys.readouterr().out.split()[-1]) == pytest.approx(printed, rel=1e-3)


def test_the_columns_of_a_plan_are_the_scenes():
    names = column_names(load_scene("three_cart"))
    columns = ", ".join(["t", *names["q"], *names["v"], *names["u"], *names["lam"]])
    assert f"`{columns}`" in README


@pytest.mark.parametrize("command", sorted(set(re.findall(r"python -m validate (\w+)", README))))
def test_a_command_exists(command: str, capsys):
    assert run([command, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_results_are_those_of_the_committed_campaign():
    """In docs/results.md all of them, here some."""
    table = results_table()
    head, *rows = [
        line
        for line in README.splitlines()
        if line.startswith("|") and line.count("|") == table.splitlines()[0].count("|")
    ]
    assert head == table.splitlines()[0]
    assert len(rows) > 5
    assert set(rows) < set(table.splitlines())
    assert table in (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def test_the_picture_is_small():
    assert (ROOT / "docs" / "report.png").stat().st_size <= 200_000
