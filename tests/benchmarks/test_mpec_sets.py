"""A set of MPECs: a global bound by a tree of convex programs, and a table whose answers are held against the published ones."""

import csv
import math

import pyomo.environ as pyo
import pytest
from click.testing import CliRunner
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.proved import prove
from benchmarks.mpec.sets import _profile, by_command, command, load, solve_one


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


SOLVED = """import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

def model():
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=1), pyo.Var(initialize=1)
    m.cost = pyo.Objective(expr=(m.x - 1)**2 + (m.y - 2)**2)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    return m
"""


@pytest.mark.slow
def test_the_table_says_how_each_answer_stands(tmp_path):
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("right", "misprint", "better", "unknown"):
        (folder / f"{name}.py").write_text(SOLVED)
    (folder / "infeasible.py").write_text(
        SOLVED.replace(
            "    return m", "    m.row = pyo.Constraint(expr=m.x + m.y <= -1)\n    return m"
        )
    )
    (folder / "broken.py").write_text("model = 1 / 0\n")
    optima = tmp_path / "optima.csv"
    optima.write_text(
        "name,published_optimum\nright,1.00001\nmisprint,0.5\nbetter,1.5\nunknown,tba\ninfeasible,3\nbroken,1\n"
    )
    page = tmp_path / "page.md"
    asked = [
        "--from",
        str(folder),
        "--optima",
        str(optima),
        "-j",
        "2",
        "--peer",
        "0",
        "-o",
        str(tmp_path / "out"),
        "--markdown",
        str(page),
    ]
    result = CliRunner().invoke(command, asked)
    assert result.exit_code == 0, result.output
    with (tmp_path / "out" / "mpec-sets-set.csv").open(newline="") as lines:
        rows = {row["problem"]: row for row in csv.DictReader(lines)}
    said = {name: row["against it"].split(":")[0] for name, row in rows.items()}
    assert said == {
        "right": "reached", "misprint": "proved optimal", "better": "better", "unknown": "",
        "infeasible": "proved infeasible", "broken": "",
    }  # fmt: skip
    assert "ZeroDivisionError" in rows["broken"]["remark"]
    assert float(rows["right"]["objective"]) == pytest.approx(1, abs=1e-8)
    assert rows["right"]["bound"] == "", "what is reached is not proved"
    assert rows["right"]["peer's CPU s"] == "", "a pair is more than none"
    lines = {line.split(" | ")[0]: line.split(" | ") for line in page.read_text().splitlines()}
    assert lines["| right"][1:7] == ["1", "solved", "1", "1.00001", "reached", "S"]
    assert len(lines["| misprint"]) == len(lines["| problem"])
    assert "beaten: 2 of 5 (1 beaten)" in result.output
    assert "by proof: 2" in result.output


ABSTRACT = """from pyomo.environ import *
from pyomo.mpec import *

model = AbstractModel()
model.far = Param()
model.x, model.y = Var(initialize=1), Var(initialize=1)
model.cost = Objective(rule=lambda m: (m.x - m.far)**2 + (m.y - 2)**2)
model.pair = Complementarity(rule=lambda m: complements(m.x >= 0, m.y >= 0))
"""


@pytest.mark.slow
def test_a_list_says_which_abstract_model_is_solved_with_which_data(tmp_path):
    """The nearer axis of (far, 2): cost far^2 while that is below 4."""
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "point.py").write_text(ABSTRACT)
    for far in (1, 3):
        (tmp_path / "set" / f"{far}.dat").write_text(f"param far := {far};\n")
    listed = tmp_path / "problems.csv"
    listed.write_text("name,model,data\nnear,point.py,1.dat\nfar,point.py,3.dat\nalone,point.py,\n")
    asked = [
        "--from",
        str(tmp_path / "set"),
        "--problems",
        str(listed),
        "-j",
        "1",
        "-o",
        str(tmp_path / "out"),
    ]
    result = CliRunner().invoke(command, asked)
    assert result.exit_code == 0, result.output
    with (tmp_path / "out" / "mpec-sets-set.csv").open(newline="") as lines:
        rows = {row["problem"]: row for row in csv.DictReader(lines)}
    assert float(rows["near"]["objective"]) == pytest.approx(1, abs=1e-8)
    assert float(rows["far"]["objective"]) == pytest.approx(4, abs=1e-8)
    assert rows["alone"]["status"] == "no answer"
    assert "ended with code 1" in rows["alone"]["remark"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (None, "holds no problem"),
        ("name,model\n,a.py\n", "name, model, data"),
        ("name,model\na,b.py\n", "b.py"),
    ],
)
def test_no_problems_and_lists_of_none_are_refused(tmp_path, text, named):
    (tmp_path / "set").mkdir()
    listed = [] if text is None else ["--problems", str(tmp_path / "list.csv")]
    if text is not None:
        (tmp_path / "list.csv").write_text(text)
    result = CliRunner().invoke(command, ["--from", str(tmp_path / "set"), *listed])
    assert result.exit_code == 2
    assert named in " ".join(result.output.split())


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
    read = load(path)
    assert solve_one(read, 0.0)["status"] == "solved"
    assert by_command(path, read, "solved", True, tmp_path) == "equal"
    assert by_command(path, read, "infeasible", True, tmp_path) == "AMPL's code 0"
    assert by_command(path, read, "solved", False, tmp_path) == "2 of 0 values"
    last = list(read.component_data_objects(pyo.Var))[1]
    last.set_value(last.value + 1e-9)
    assert by_command(path, read, "solved", True, tmp_path) == "1.0e-09 away"
    path.write_text("no problem")
    assert by_command(path, read, "solved", True, tmp_path).startswith("code 2: touchstone-mpec: ")
