"""The worked examples of plans from other packages run, and their verdicts are those on the page (docs/examples/README.md). NumPy and MuJoCo always, others by hand: -m peer."""

import re
import runpy
from pathlib import Path

import pytest

import touchstone as ts

FOLDER = Path(__file__).parents[1] / "docs" / "examples"
EXAMPLES = sorted(path.stem.removeprefix("plan_from_") for path in FOLDER.glob("plan_from_*.py"))
# (package, verdict, cost, replay error [m]) of each row of the page.
ROWS = re.findall(
    r"^\| \[(\w+)\]\(plan_from_\1\.py\) [^|]*\| [^|]*\| [^|]*\| (\w[\w ]*) \| ([\d.]+) \| ([\d.e-]+) \|",
    (FOLDER / "README.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "package",
    [
        name if name in ("numpy", "mujoco") else pytest.param(name, marks=pytest.mark.peer)
        for name in EXAMPLES
    ],
)
def test_an_example_writes_a_plan_with_the_verdict_of_the_page(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("pydrake" if package == "drake" else package)
    verdict, cost, error = {name: told for name, *told in ROWS}[package]
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(FOLDER / f"plan_from_{package}.py"))
    found = ts.judge("three_cart", "plan.csv")
    assert found.verdict.value == verdict, str(found)
    # Another version of a solver may stop elsewhere; a plan of another kind would differ by more.
    assert found.score.value("cost") == pytest.approx(float(cost), rel=0.02)
    assert found.score.value("replay_error") == pytest.approx(float(error), rel=0.2, abs=1e-4)


def test_every_example_has_its_row():
    assert (
        sorted(name for name, *_ in ROWS)
        == EXAMPLES
        == ["casadi", "crocoddyl", "drake", "mujoco", "numpy", "pydrake"]
    )
