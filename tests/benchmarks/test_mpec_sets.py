"""A set of MPECs: a global bound by a tree of convex programs, and a table whose answers are held against the published ones."""

import csv
import math
from pathlib import Path

import pyomo.environ as pyo
import pytest
from click.testing import CliRunner
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.proved import prove
from benchmarks.mpec.sets import _profile, by_command, command, solve_one
from formulations.ampl import read_nl


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
    assert rows["right"]["command"] == "equal"
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


def test_the_profile_counts_who_has_the_better_answer_and_how_soon():
    """Ours and the peer's cost and seconds: both right, ours 3 times slower; the peer not feasible.

    The peer better; a maximum that ours has higher.
    """
    rows = [
        {
            "status": status,
            "sense": sense,
            "objective": mine,
            "solve_s": 3.0,
            "peer_objective": theirs,
            "peer_feasible": feasible,
            "peer_s": 1.0,
        }
        for status, sense, mine, theirs, feasible in (
            ("solved", 1, 5.0, 5.0004, True),
            ("solved", 1, 5.0, 4.0, False),
            ("solved", 1, 5.0, 4.0, True),
            ("solved", -1, 5.0, 4.0, True),
        )
    ]
    table = _profile([*rows, {"status": "solved", "sense": 1, "objective": 1.0, "solve_s": 1.0}])
    told = {name: dict(zip(table.columns[1:], shares, strict=True)) for name, *shares in table.rows}
    assert "4 problems" in table.caption
    assert (
        told["mpec_ipopt"]["within 1 times"],
        told["mpec_ipopt"]["within 4 times"],
        told["mpec_ipopt"]["at all"],
    ) == (
        "50%",
        "75%",
        "75%",
    )
    assert told["casadi_scholtes"]["within 1 times"] == told["casadi_scholtes"]["at all"] == "50%"


@pytest.mark.slow
def test_the_command_is_held_against_the_answer_bit_by_bit(tmp_path):
    model = pyo.ConcreteModel()
    model.x = pyo.Var(range(2), initialize=0.3)
    model.cost = pyo.Objective(expr=(model.x[0] - 1.0) ** 2 + (model.x[1] - 2.0) ** 4)
    model.row = pyo.Constraint(expr=model.x[0] + 3.0 * model.x[1] <= 2.0)
    path = tmp_path / "ex9.1.1.nl"
    model.write(str(path))
    read = read_nl(path, relax_integers=True)
    assert solve_one(read, 0.0)["status"] == "solved"
    assert by_command(path, read, "solved", True, tmp_path) == "equal"
    assert by_command(path, read, "infeasible", True, tmp_path) == "AMPL's code 0"
    assert by_command(path, read, "solved", False, tmp_path) == "2 of 0 values"
    last = list(read.component_data_objects(pyo.Var))[1]
    last.set_value(last.value + 1e-9)
    assert by_command(path, read, "solved", True, tmp_path) == "1.0e-09 away"
    path.write_text("no problem")
    assert by_command(path, read, "solved", True, tmp_path).startswith("code 2: touchstone-mpec: ")
