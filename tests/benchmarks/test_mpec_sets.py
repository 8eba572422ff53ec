"""A set of MPECs: a global bound by a tree of convex programs, and a table whose answers are held against the published ones."""

import csv
import math
from pathlib import Path

import pyomo.environ as pyo
import pytest
from click.testing import CliRunner
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.proved import prove
from benchmarks.mpec.sets import command


def _pairs(sense=pyo.minimize, goals=((1, 2), (3, -1), (2, 2))) -> pyo.ConcreteModel:
    """Distances to points in the plane, each on one of two axes: every pair leaves out its smaller positive part."""
    model, sign = pyo.ConcreteModel(), 1 if sense == pyo.minimize else -1
    model.x = pyo.Var(range(2 * len(goals)), initialize=1.0)
    model.cost = pyo.Objective(
        expr=sign
        * sum((model.x[2 * k + i] - goal[i]) ** 2 for k, goal in enumerate(goals) for i in (0, 1)),
        sense=sense,
    )
    model.pair = Complementarity(
        range(len(goals)), rule=lambda m, k: complements(m.x[2 * k] >= 0, m.x[2 * k + 1] >= 0)
    )
    return model


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_the_bound_is_the_best_of_all_branches(sense):
    sign = 1 if sense == pyo.minimize else -1
    found = prove(_pairs(sense))
    assert found.complete
    assert found.bound == pytest.approx(sign * (1 + 1 + 4), abs=1e-5)
    assert found.best == pytest.approx(sign * (1 + 1 + 4), abs=1e-5)
    assert found.programs > 1


def test_a_known_value_only_shortens_the_proof():
    alone, told = prove(_pairs()), prove(_pairs(), best=6.0)
    assert told.bound == pytest.approx(alone.bound, abs=1e-5)
    assert told.programs <= alone.programs
    assert (
        prove(_pairs(), best=5.0).bound <= 5.0 + 1e-6
    )  # a value that no point has stays what it was told to be


def test_what_is_cut_off_is_no_proof():
    found = prove(_pairs(), seconds=0.0)
    assert not found.complete
    assert found.bound == -math.inf


def test_rows_that_no_branch_satisfies():
    model = _pairs()
    model.row = pyo.Constraint(expr=model.x[0] + model.x[1] <= -1)
    found = prove(model)
    assert (found.complete, found.bound) == (True, math.inf)


@pytest.mark.parametrize("change", ["nonlinear row", "concave objective", "nonlinear objective"])
def test_other_kinds_are_not_proved(change):
    model = _pairs()
    if change == "nonlinear row":
        model.row = pyo.Constraint(expr=model.x[0] * model.x[1] <= 1)
    else:
        model.cost.set_value(
            -(model.x[0] ** 2) if change == "concave objective" else pyo.exp(model.x[0])
        )
    assert prove(model) is None


def _write(path: Path, row: bool = False) -> None:
    """The nearer of two half-axes to (1, 2), cost 1; with `row` without a feasible point."""
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(initialize=1), pyo.Var(initialize=1)
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + (model.y - 2) ** 2)
    model.pair = Complementarity(expr=complements(model.x >= 0, model.y >= 0))
    if row:
        model.row = pyo.Constraint(expr=model.x + model.y <= -1)
    pyo.TransformationFactory("mpec.nl").apply_to(model)
    model.write(str(path), format="nl_v1")


@pytest.mark.slow
def test_the_table_says_how_each_answer_stands(tmp_path):
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("right", "misprint", "better", "unknown"):
        _write(folder / f"{name}.nl")
    _write(folder / "infeasible.nl", row=True)
    (folder / "broken.nl").write_text("no problem")
    optima = tmp_path / "optima.csv"
    optima.write_text(
        "name,published_optimum\nright,1.00001\nmisprint,0.5\nbetter,1.5\nunknown,tba\ninfeasible,3\nbroken,1\n"
    )
    page = tmp_path / "page.md"
    asked = ["--from", str(folder), "--optima", str(optima), "-j", "2", "--peer", "0"]
    asked += ["-o", str(tmp_path / "out"), "--markdown", str(page)]
    result = CliRunner().invoke(command, asked)
    assert result.exit_code == 0, result.output
    with (tmp_path / "out" / "mpec-sets-set.csv").open(newline="") as lines:
        rows = {row["problem"]: row for row in csv.DictReader(lines)}
    said = {name: row["against it"].split(":")[0] for name, row in rows.items()}
    assert said == {
        "right": "reached", "misprint": "proved optimal", "better": "better", "unknown": "",
        "infeasible": "proved infeasible", "broken": "",
    }  # fmt: skip
    assert rows["broken"]["status"] == "no answer"
    assert "ended with code 1" in rows["broken"]["remark"]
    assert float(rows["right"]["objective"]) == pytest.approx(1, abs=1e-8)
    assert rows["right"]["bound"] == "", "what is reached is not proved"
    assert rows["right"]["peer's CPU s"] == "", "a pair is more than none"
    lines = {line.split(" | ")[0]: line.split(" | ") for line in page.read_text().splitlines()}
    assert lines["| right"][1:7] == ["1", "solved", "1", "1.00001", "reached", "S"]
    assert len(lines["| misprint"]) == len(lines["| problem"])
    assert "beaten: 2 of 5 (1 beaten)" in result.output
    assert "by proof: 2" in result.output


def test_a_folder_without_problems_is_refused(tmp_path):
    result = CliRunner().invoke(command, ["--from", str(tmp_path)])
    assert result.exit_code == 2
    assert "holds no `.nl` file" in " ".join(result.output.split())
