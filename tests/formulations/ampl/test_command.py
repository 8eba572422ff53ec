"""The solver as AMPL and Pyomo call it: options, codes, and a `.sol` file whose duals are the change of the objective by each right-hand side."""

import os
import sys
from pathlib import Path

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements
from pyomo.opt.plugins.sol import ResultsReader_sol
from wording import unsaid

from formulations.ampl.command import main

# min or max sense*((x0 - 1)^2 + (x1 - 2)^2 + (x2 + 1)^2 + (x3 - 3)^2) with
#   row 0: x0 + x1 >= A;   row 1: x0 - x3 == B;   row 2: C <= x1 + x3 <= 9;   row 3: the body x2 - D complements x1 by its sides
PROBLEM = """g3 1 1 0
 4 4 1 1 1
 0 1 1 0 0 0
 0 0
 0 4 0
 0 0 0 1
 0 0 0 0 0
 7 4
 0 0
 0 0 0 0 0
C3
n{shift}
O0 {sense}
o2
n{factor}
o54
4
o5
o1
v0
n1
n2
o5
o1
v1
n2
n2
o5
o0
v2
n1
n2
o5
o1
v3
n3
n2
x4
0 1
1 1
2 {start}
3 2
r
2 {a}
4 {b}
0 {c} 9
5 {sides} 2
b
3
{bounds}
3
3
J0 2
0 1
1 1
J1 2
0 1
3 -1
J2 2
1 1
3 1
J3 1
2 1
G0 4
0 0
1 0
2 0
3 0
"""


@pytest.fixture
def stub(tmp_path):
    def write(**numbers) -> Path:
        values = {"a": 4.0, "b": -0.5, "c": 6.0, "d": 0.5, "sense": 0, "sides": 1, "bounds": "2 0.5", "start": 1.0, **numbers}
        path = tmp_path / "problem.nl"
        path.write_text(PROBLEM.format(**values, shift=-values["d"], factor=-1.0 if values["sense"] else 1.0))
        return path.with_suffix("")

    return write


def read_sol(stub: Path) -> tuple[str, list[float], list[float], int]:
    lines = stub.with_suffix(".sol").read_text().splitlines()
    end = lines.index("")
    rows, duals, variables, values = map(int, lines[end + 6 : end + 10])
    assert lines[end + 1 : end + 6] == ["Options", "3", "1", "1", "0"]
    assert (rows, variables) == (4, 4)
    numbers = [float(line) for line in lines[end + 10 : end + 10 + duals + values]]
    word, objective, code = lines[end + 10 + duals + values].split()
    assert (word, objective) == ("objno", "0")
    return "\n".join(lines[:end]), numbers[:duals], numbers[duals:], int(code)


def solve(stub: Path) -> tuple[float, list[float]]:
    assert main([str(stub), "-AMPL", "tol=1e-11"]) == 0
    message, duals, x, code = read_sol(stub)
    assert code == 0, message
    return (x[0] - 1) ** 2 + (x[1] - 2) ** 2 + (x[2] + 1) ** 2 + (x[3] - 3) ** 2, duals


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sides", "bounds", "start", "d"),
    [(1, "2 0.5", 1.0, 0.5), (2, "1 8", -3.0, -3.0), (3, "0 0.5 8", 1.0, 0.5), (3, "0 -9 1.5", -3.0, -3.0), (0, "3", 0.5, 0.5)],
)
@pytest.mark.parametrize("sense", [0, 1])
def test_duals_are_the_change_of_the_objective_by_the_right_hand_side(stub, sides, bounds, start, d, sense):
    given = {"sides": sides, "bounds": bounds, "start": start, "d": d, "sense": sense}
    _, duals = solve(stub(**given))
    step = 1e-3  # the optimal value is quadratic here, so central differences have no error but rounding
    sign = -1.0 if sense else 1.0
    for number, name in enumerate("abcd"):
        value = {"a": 4.0, "b": -0.5, "c": 6.0, "d": d}[name]
        above, _ = solve(stub(**given | {name: value + step}))
        below, _ = solve(stub(**given | {name: value - step}))
        assert duals[number] == pytest.approx(sign * (above - below) / (2 * step), abs=2e-6), name
    assert max(map(abs, duals)) > 0.1


@pytest.mark.parametrize("sense", [0, 1])
def test_the_multiplier_of_the_variables_side_is_a_suffix_that_pyomo_reads(stub, sense):
    """The body is 2, so x1 stays at its bound, and the objective changes with that."""
    step, cost = 1e-3, {}
    for bound in (4.5, 4.5 + step, 4.5 - step):
        path = stub(d=-3.0, start=-1.0, bounds=f"2 {bound}", sense=sense)
        cost[bound], duals = solve(path)
        if bound == 4.5:
            answer = ResultsReader_sol()(str(path.with_suffix(".sol")), suffixes=[".*"]).solution(0).constraint
    change = (-1.0 if sense else 1.0) * (cost[4.5 + step] - cost[4.5 - step]) / (2 * step)
    assert {name: entry["Pair_dual"] for name, entry in answer.items() if "Pair_dual" in entry} == {"c3": pytest.approx(change, abs=1e-6)}
    assert abs(change) > 1.0
    assert duals[3] == 0.0


@pytest.mark.slow
def test_an_infeasible_problem_says_so_in_its_code(stub):
    path = stub(c=7.0, a=40.0, bounds="0 0.5 1")
    assert main([str(path), "-AMPL"]) == 0
    message, *_, code = read_sol(path)
    assert (code, "infeasible" in message) == (200, True)


def test_what_the_solver_refuses_is_code_500_with_the_reason(stub, capsys):
    path = stub()
    text = path.with_suffix(".nl").read_text().replace(" 0 0 0 0 0\n 7 4", " 0 1 0 0 0\n 7 4")
    path.with_suffix(".nl").write_text(text)
    assert main([str(path), "-AMPL"]) == 0
    message, duals, values, code = read_sol(path)
    assert (duals, values, code) == ([], [], 500)
    assert "x[3]" in message
    assert main([str(path)]) == 2
    assert "x[3]" in capsys.readouterr().err
    assert main([str(path), "relax_integers=1"]) == 0


def test_options_come_from_the_environment_and_the_command_line(stub, capsys, monkeypatch):
    path = stub()
    monkeypatch.setenv("touchstone_mpec_options", "strategy=scholtes")
    assert main([str(path)]) == 0
    assert "scholtes" in capsys.readouterr().out
    assert main([str(path), "strategy=direct"]) == 0
    assert "direct" in capsys.readouterr().out
    assert main([str(path), "outlev=0", "-AMPL"]) == 0
    assert capsys.readouterr().out == ""
    assert main([str(path), "outlev=1", "-AMPL"]) == 0
    assert "objective" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["nothing"], ("nothing.nl", "cannot be read")), ([""], ("no file", ".nl")), (["/"], ("'/' is no file",)), (["."], ("'.' is no file",)), ([], ("usage",)), (["a", "b"], ("usage",)), (["STUB", "-q"], ("usage",)),
        (["STUB", "strategy=magic"], ("strategy", "magic", "scholtes")), (["STUB", "objno=2"], ("1 objectives", "2")),
        (["STUB", "objno=half"], ("objno", "half")), (["STUB", "timelimit=-1"], ("timelimit", "-1", "seconds")), (["STUB", "tol="], ("tol=", "name=value")),
        (["STUB", "tolerance_of_all=1"], ("tolerance_of_all",)),
    ],
)  # fmt: skip
def test_bad_calls_end_in_one_sentence(stub, capsys, words, parts):
    path = str(stub())
    assert main([path if word == "STUB" else word for word in words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert not unsaid(said.err, *parts)


def test_it_says_its_options_and_its_version(capsys):
    assert main(["-="]) == 0
    assert {"objno", "strategy", "timelimit"} <= {line.split()[0] for line in capsys.readouterr().out.splitlines()}
    assert main(["-v"]) == 0
    assert capsys.readouterr().out.startswith("touchstone-mpec ")


@pytest.mark.slow
def test_pyomo_calls_it_as_an_ampl_solver(tmp_path, monkeypatch):
    command = tmp_path / "touchstone-mpec"
    root = Path(__file__).resolve().parents[3]
    command.write_text(
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(root)!r})\nfrom formulations.ampl.command import main\nsys.exit(main())\n"
    )
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(bounds=(0, None), initialize=1), pyo.Var(initialize=1)
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + (model.y - 2) ** 2)
    model.pair = Complementarity(expr=complements(model.y >= 0, model.x >= 0))
    pyo.TransformationFactory("mpec.nl").apply_to(model)
    results = pyo.SolverFactory("asl:touchstone-mpec").solve(model, options={"strategy": "scholtes"})
    pyo.assert_optimal_termination(results)
    assert (model.x.value, model.y.value) == pytest.approx((0, 2), abs=1e-8)
    assert "scholtes" in results.solver.message
