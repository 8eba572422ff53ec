"""`.nl` files as Pyomo models: what is written is read, text or binary, and what is damaged or cannot be said is named with its place. The solver as AMPL and Pyomo call it: options, codes, and a `.sol` file whose duals are the change of the objective by each right-hand side."""

import math
import os
import shlex
import struct
import subprocess
import sys
from pathlib import Path

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements
from pyomo.opt.plugins.sol import ResultsReader_sol
from wording import unsaid

from formulations.ampl import NlError, read_nl
from formulations.ampl.command import main
from formulations.mpec import solve_mpec

# min (x0 - 1)^2 + sin(d) + 3 x1, d = 2 x0 + x1 x2; row 0: 1 <= x0 x1 + 4 x2 <= 7; row 1: exp(x2) -
# x1 = 0.5; row 2: x0 + x1 - 2 complements x2 >= 0.25
SEGMENTS = [
    ("V", "iii", 3, 1, 0), (None, "id", 0, 2.0), ("o", "o", 2), ("v", "i", 1), ("v", "i", 2),
    ("C", "i", 0), ("o", "o", 2), ("v", "i", 0), ("v", "i", 1),
    ("C", "i", 1), ("o", "o", 44), ("v", "i", 2),
    ("C", "i", 2), ("s", "h", -2),
    ("O", "ii", 0, 0), ("o", "o", 0), ("o", "o", 5), ("o", "o", 0), ("v", "i", 0), ("n", "d", -1.0),
    ("l", "i", 2), ("o", "o", 41), ("v", "i", 3),
    ("S", "iis", 0, 1, "priority"), (None, "ii", 2, 7), ("S", "iis", 5, 1, "weight"),
    (None, "id", 1, 0.5),
    ("x", "i", 2), (None, "id", 0, 1.5), (None, "id", 2, -0.5),
    ("d", "i", 1), (None, "id", 1, 0.75),
    ("r", ""), ("0", "dd", 1.0, 7.0), ("4", "d", 0.5), ("5", "ii", 1, 3),
    ("b", ""), ("1", "d", 9.0), ("3", ""), ("2", "d", 0.25),
    ("k", "i", 2), (None, "i", 2), (None, "i", 5),
    ("J", "ii", 0, 3), (None, "id", 0, 0.0), (None, "id", 1, 0.0), (None, "id", 2, 4.0),
    ("J", "ii", 1, 2), (None, "id", 1, -1.0), (None, "id", 2, 0.0), ("J", "ii", 2, 2),
    (None, "id", 0, 1.0), (None, "id", 1, 1.0),
    ("G", "ii", 0, 3), (None, "id", 0, 0.0), (None, "id", 1, 3.0), (None, "id", 2, 0.0),
]  # fmt: skip
HEADER = """{letter}3 1 1 0\t# a problem
 3 3 1 1 1 \t# vars, constraints, objectives, ranges, eqns
 2 1 1 0 0 1\t# nonlinear constrs, objs; ccons: lin, nonlin, nd, nzlb
 0 0
 3 3 3
 0 0 {arithmetic} 1
 {integers} 0 0 0
 7 3
 0 0
 1 0 0 0 0
"""


def _header(letter: str, arithmetic: int = 0, integers: str = "0 0") -> str:
    return HEADER.format(letter=letter, arithmetic=arithmetic, integers=integers)


def as_text(segments=SEGMENTS, **header) -> bytes:
    lines = [
        f"{code or ''}{' '.join(map(str, values))}\t# a comment" for code, _, *values in segments
    ]
    return (_header("g", **header) + "\n".join(lines) + "\n").encode()


def as_binary(order: str, letter: str = "b") -> bytes:
    data = _header(letter, arithmetic={"<": 1, ">": 2}[order]).encode()
    for code, form, *values in SEGMENTS:
        data += (code or "").encode()
        for kind, value in zip(form, values, strict=True):
            if kind == "s":
                data += struct.pack(f"{order}i", len(value)) + value.encode()
            else:
                data += struct.pack(
                    order + {"o": "h" if letter == "z" else "i"}.get(kind, kind), value
                )
    return data


@pytest.fixture
def written(tmp_path):
    def write(data: bytes) -> Path:
        path = tmp_path / "problem.nl"
        path.write_bytes(data)
        return path

    return write


FORMS = {
    "text": as_text(), "little": as_binary("<"), "big": as_binary(">"),
    "short codes": as_binary("<", "z"), "crlf": as_text().replace(b"\n", b"\r\n"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_says_the_same(written, form):
    model = read_nl(written(FORMS[form]))
    x = model.x
    assert [(x[i].lb, x[i].ub) for i in range(3)] == [(None, 9.0), (None, None), (0.25, None)]
    assert [x[i].value for i in range(3)] == [1.5, None, -0.5]
    for values in ((0.3, -1.2, 0.7), (-2.0, 0.4, 1.9)):
        for i, value in enumerate(values):
            x[i].set_value(value)
        x0, x1, x2 = values
        assert pyo.value(model.objective[1].expr) == pytest.approx(
            (x0 - 1) ** 2 + math.sin(2 * x0 + x1 * x2) + 3 * x1, rel=1e-15
        )
        assert pyo.value(model.row[0].body) == pytest.approx(x0 * x1 + 4 * x2, rel=1e-15)
        assert pyo.value(model.row[1].body) == pytest.approx(math.exp(x2) - x1, rel=1e-15)
        first, second = model.pair[2]._args
        assert (pyo.value(first.args[1]), pyo.value(first.args[0])) == pytest.approx(
            (x0 + x1 - 2, 0.0)
        )
        assert (pyo.value(second.args[1]), pyo.value(second.args[0])) == (x2, 0.25)
    assert (pyo.value(model.row[0].lower), pyo.value(model.row[0].upper)) == (1.0, 7.0)
    assert model.row[1].equality
    assert pyo.value(model.row[1].lower) == 0.5
    assert model.objective[1].sense == pyo.minimize
    assert (model.priority[x[2]], model.weight[model.row[1]], model.dual[model.row[1]]) == (
        7,
        0.5,
        0.75,
    )


def test_names_stand_beside_the_file(written):
    path = written(FORMS["text"])
    path.with_suffix(".col").write_text("flow[1,'a']\nspeed\nforce\n")
    path.with_suffix(".row").write_text("balance\nlaw\ncontact\nthe objective\n")
    model = read_nl(path.with_suffix(""))
    assert [data.name for data in model.component_data_objects((pyo.Constraint, Complementarity),
        descend_into=False)] == [
        "row[balance]", "row[law]", "pair[contact]",
    ]  # fmt: skip
    assert list(model.x) == ["flow[1,'a']", "speed", "force"]


@pytest.mark.parametrize(("row", "bounds", "start", "best"), [
    # min (y - 3)^2 + (z - 1)^2 with y - 1 and z: the pair leaves one side; the nearer one wins
    ((1,), ("2", "d", 0.0), (1.0, 1.0), (3.0, 0.0)),
    ((2,), ("1", "d", 0.0), (1.0, -1.0), (1.0, 0.0)),
    ((3,), ("0", "dd", 0.0, 0.5), (1.0, 0.2), (3.0, 0.0)),
    ((3,), ("0", "dd", 0.0, 5e25), (1.0, 1.0), (3.0, 0.0)),
    ((3,), ("0", "dd", -1e19, 0.0), (1.0, -1.0), (1.0, 0.0)),
    ((0,), ("3", ""), (0.0, 0.0), (1.0, 1.0)),
])  # fmt: skip
def test_each_kind_of_complementarity(written, row, bounds, start, best):
    segments = [
        ("C", "i", 0), ("n", "d", -1.0),
        ("O", "ii", 0, 0), ("o", "o", 0), ("o", "o", 5), ("o", "o", 1), ("v", "i", 0),
        ("n", "d", 3.0), ("n", "d", 2.0),
        ("o", "o", 5), ("o", "o", 1), ("v", "i", 1), ("n", "d", 1.0), ("n", "d", 2.0),
        ("x", "i", 2), (None, "id", 0, start[0]), (None, "id", 1, start[1]),
        ("r", ""), ("5", "ii", *row, 2), ("b", ""), ("3", ""), bounds,
        ("J", "ii", 0, 1), (None, "id", 0, 1.0), ("G", "ii", 0, 2), (None, "id", 0, 0.0),
        (None, "id", 1, 0.0),
    ]  # fmt: skip
    header = "g3 1 1 0\n 2 1 1 0 0\n 0 1 1 0 0 0\n 0 0\n 0 2 0\n 0 0 0 1\n 0 0 0 0 0\n 1 2\n 0 0\n 0 0 0 0 0\n"
    lines = [f"{code or ''}{' '.join(map(str, values))}" for code, _, *values in segments]
    result = solve_mpec(read_nl(written((header + "\n".join(lines) + "\n").encode())))
    assert result.solved, result.message
    assert dict(zip((v.name for v in result.variables), result.x, strict=True)) == pytest.approx(
        {"x[0]": best[0], "x[1]": best[1]}, abs=1e-7
    )


def test_a_variable_of_a_lower_side_keeps_its_upper_bound(written):
    data = as_text(
        [item if item != ("2", "d", 0.25) else ("0", "dd", 0.25, 5.0) for item in SEGMENTS]
    )
    model = read_nl(written(data))
    assert (model.x[2].lb, model.x[2].ub) == (0.25, 5.0)
    assert len([side for side in model.pair[2]._args if len(side.args) == 2]) == 2


@pytest.mark.parametrize(
    ("operator", "least"), [(11, min), (12, max), (54, lambda *values: sum(values))]
)
def test_operators_of_any_number_of_terms(written, operator, least):
    terms = [("o", "o", operator), (None, "i", 3), ("v", "i", 0), ("n", "d", 2.5), ("v", "i", 2)]
    begin = next(i for i, item in enumerate(SEGMENTS) if item[:3] == ("C", "i", 1))
    model = read_nl(written(as_text([*SEGMENTS[: begin + 1], *terms, *SEGMENTS[begin + 3 :]])))
    for values in ((0.5, 0.0, 7.0), (9.0, 0.0, 3.0)):
        for i, value in enumerate(values):
            model.x[i].set_value(value)
        assert pyo.value(model.row[1].body) == pytest.approx(least(values[0], 2.5, values[2]))


def test_integers_are_read_and_relaxed_when_asked(written):
    path = written(as_text(integers="1 1"))
    assert [variable.is_integer() for variable in read_nl(path).x.values()] == [False, True, True]
    assert not any(
        variable.is_integer() for variable in read_nl(path, relax_integers=True).x.values()
    )


def test_an_objective_is_chosen_and_maximised(written):
    path = written(
        as_text([item if item != ("O", "ii", 0, 0) else ("O", "ii", 0, 1) for item in SEGMENTS])
    )
    assert read_nl(path).objective[1].sense == pyo.maximize
    assert not read_nl(path, objective=0).objective[1].active
    with pytest.raises(NlError, match="1 objectives; 2"):
        read_nl(path, objective=2)


@pytest.mark.parametrize("form", ["text", "little"])
def test_a_file_cut_off_anywhere_is_refused(written, form):
    data = FORMS[form]
    begin = data.index(b"V")
    for end in range(begin, len(data) - 12, 7):
        with pytest.raises(NlError, match=r"cut off|damaged"):
            read_nl(written(data[:end]))


def _with(index: int, item: tuple) -> bytes:
    return as_text([*SEGMENTS[:index], item, *SEGMENTS[index + 1 :]])


_AT = {code: next(i for i, item in enumerate(SEGMENTS) if item[0] == code) for code in "5vkJxorO"}


@pytest.mark.parametrize(("data", "parts"), [
    (_with(_AT["5"], ("5", "ii", 1, 9)), ("row 2", "variable 8", "0 to 2")),
    (_with(_AT["5"], ("5", "ii", 1, 0)), ("row 2", "variable -1")),
    (_with(_AT["5"], ("5", "ii", 7, 3)), ("row 2", "sides 7")),
    (_with(_AT["5"], ("5", "ii", 2, 3)), ("row 2", "upper bound of variable 2", "none")),
    (_with(_AT["5"] - 2, ("0", "dd", "nan", 7.0)), ("row 0", "no number")),
    (_with(_AT["5"] - 2, ("0", "dd", 7.0, 1.0)), ("row 0", "bounds 7 and 1")),
    (_with(_AT["5"] - 1, ("4", "d", "inf")), ("row 1", "inf")),
    (_with(_AT["v"], ("v", "i", 4)), ("common expression 1",)),
    (_with(_AT["v"], ("v", "i", 3)), ("common expression 0", "before")),
    (_with(_AT["o"], ("o", "o", 35)), ("'if'",)),
    (_with(_AT["o"], ("o", "o", 999)), ("999",)),
    (_with(_AT["v"], ("f", "ii", 0, 1)), ("imported function '0'",)),
    (_with(_AT["J"], ("J", "ii", 5, 3)), ("row 5", "0 to 2")),
    (_with(_AT["J"], ("J", "ii", 0, 8)), ("8 entries", "at most 3")),
    (_with(_AT["x"] + 1, (None, "id", 3, 1.0)), ("entry 3", "0 to 2")),
    (_with(_AT["x"] + 1, (None, "id", 0, "one")), ("a whole number, a number", "0 one")),
    (_with(_AT["r"], ("L", "i", 0)), ("logical constraint",)),
    (_with(_AT["k"], ("q", "i", 2)), ("'q'",)), (b"", ("no .nl file", "header")),
    (b"not a problem\n" * 12, ("no .nl file",)),
    (as_text().replace(b" 3 3 1 1 1 ", b" 3 3 1 1 1 2"), ("2 logical constraints",)),
    (as_text().replace(b" 3 3 1 1 1 ", b" three 3 1 1 1 "), ("line 2", "whole numbers", "three")),
    (as_text().replace(b" 3 3 1 1 1 ", b" 999999999 3 1 1 1 "),
     ("line 2", "999999999 variables", "bytes")),
    (as_binary("<").replace(b" 0 0 1 1", b" 0 0 2 1"), ("byte order differs",)),
    (as_binary("<").replace(b" 0 0 1 1", b" 0 0 5 1"), ("line 6", "arithmetic 5")),
])  # fmt: skip
def test_what_is_damaged_or_cannot_be_said_is_named(written, data, parts):
    with pytest.raises(NlError) as refused:
        read_nl(written(data))
    assert not unsaid(refused.value, "problem.nl", *parts)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(NlError, match=r"nothing\.nl cannot be read"):
        read_nl(tmp_path / "nothing")


def test_what_pyomo_writes_is_read_back(tmp_path):
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(bounds=(0.1, 4), initialize=1.5), pyo.Var(initialize=0.7)
    model.shared = pyo.Expression(expr=model.x * pyo.sin(model.y) + 1)
    functions = (
        pyo.sqrt,
        pyo.exp,
        pyo.log,
        pyo.log10,
        pyo.cos,
        pyo.tan,
        pyo.atan,
        pyo.sinh,
        pyo.cosh,
        pyo.tanh,
        pyo.asinh,
    )
    model.row = pyo.Constraint(
        expr=sum(function(model.x) for function in functions) - model.shared**2 == 1
    )
    model.range = pyo.Constraint(expr=pyo.inequality(-1, model.x / model.shared - 2 * model.y, 5))
    model.small = pyo.Constraint(
        expr=pyo.asin(model.x / 9)
        + pyo.acos(model.y / 9)
        + pyo.acosh(1 + model.x)
        + pyo.atanh(model.y / 9)
        <= 8
    )
    model.cost = pyo.Objective(expr=abs(model.x - model.y) + model.shared**3, sense=pyo.maximize)
    model.write(str(tmp_path / "written.nl"), io_options={"symbolic_solver_labels": True})
    again = read_nl(tmp_path / "written.nl")
    assert {name: again.x[name].value for name in again.x} == {"x": 1.5, "y": 0.7}
    assert pyo.value(again.objective[1]) == pytest.approx(pyo.value(model.cost), rel=1e-15)
    assert again.objective[1].sense == pyo.maximize
    for name in ("row", "range", "small"):
        ours, theirs = again.row[name], model.component(name)
        shift = pyo.value(ours.body) - pyo.value(
            theirs.body
        )  # Pyomo moves constants to the other side
        for bound in ("lower", "upper"):
            a, b = getattr(ours, bound), getattr(theirs, bound)
            assert (a is None) == (b is None)
            assert b is None or pyo.value(a) - pyo.value(b) == pytest.approx(shift, abs=1e-13)


# min or max sense*((x0 - 1)^2 + (x1 - 2)^2 + (x2 + 1)^2 + (x3 - 3)^2) with
#   row 0: x0 + x1 >= A; row 1: x0 - x3 == B; row 2: C <= x1 + x3 <= 9; row 3: the body x2 - D
#   complements x1 by its sides
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
        values = {
            "a": 4.0,
            "b": -0.5,
            "c": 6.0,
            "d": 0.5,
            "sense": 0,
            "sides": 1,
            "bounds": "2 0.5",
            "start": 1.0,
            **numbers,
        }
        path = tmp_path / "problem.nl"
        path.write_text(
            PROBLEM.format(**values, shift=-values["d"], factor=-1.0 if values["sense"] else 1.0)
        )
        return path.with_suffix("")

    return write


@pytest.mark.parametrize("asked", ["STUB", "-v", "-="])
@pytest.mark.parametrize(
    ("out", "why"),
    [("> /dev/full", "No space left on device"), (">&-", "standard output is closed")],
)
def test_an_answer_that_cannot_be_printed_ends_with_3(stub, asked: str, out: str, why: str):
    command = [
        sys.executable,
        "-c",
        "from formulations.ampl.command import main; raise SystemExit(main())",
        asked.replace("STUB", str(stub())),
    ]
    ended = subprocess.run(
        f"exec {shlex.join(command)} {out}", shell=True, stderr=subprocess.PIPE, text=True,
        env={key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"},
    )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (
        3,
        f"touchstone-mpec: the answer cannot be written: {why}.\n",
    )


def test_a_solution_file_that_cannot_be_written_ends_with_3(stub, capsys):
    problem = stub()
    problem.with_suffix(".sol").mkdir()
    assert main([str(problem), "-AMPL"]) == 3
    assert (
        capsys.readouterr().err
        == f"touchstone-mpec: {problem}.sol cannot be written: Is a directory.\n"
    )


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
    [
        (1, "2 0.5", 1.0, 0.5),
        (2, "1 8", -3.0, -3.0),
        (3, "0 0.5 8", 1.0, 0.5),
        (3, "0 -9 1.5", -3.0, -3.0),
        (3, "4 0.5", 0.5, 0.5),
        (0, "3", 0.5, 0.5),
    ],
)
@pytest.mark.parametrize("sense", [0, 1])
def test_duals_are_the_change_of_the_objective_by_the_right_hand_side(
    stub, sides, bounds, start, d, sense
):
    given = {"sides": sides, "bounds": bounds, "start": start, "d": d, "sense": sense}
    _, duals = solve(stub(**given))
    # the optimal value is quadratic here, so central differences have no error but rounding
    step = 1e-3
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
            answer = (
                ResultsReader_sol()(str(path.with_suffix(".sol")), suffixes=[".*"])
                .solution(0)
                .constraint
            )
    change = (-1.0 if sense else 1.0) * (cost[4.5 + step] - cost[4.5 - step]) / (2 * step)
    assert {name: entry["Pair_dual"] for name, entry in answer.items() if "Pair_dual" in entry} == {
        "c3": pytest.approx(change, abs=1e-6)
    }
    assert abs(change) > 1.0
    assert duals[3] == 0.0


@pytest.mark.slow
def test_an_infeasible_problem_says_so_in_its_code(stub, capsys):
    path = stub(c=7.0, a=40.0, bounds="0 0.5 1")
    assert main([str(path), "-AMPL"]) == 0
    message, *_, code = read_sol(path)
    assert (code, "infeasible" in message) == (200, True)
    capsys.readouterr()
    assert main([str(path)]) == 1
    assert capsys.readouterr().out.strip().endswith("(AMPL's code 200)")


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


@pytest.mark.parametrize(("words", "parts"), [
    (["nothing"], ("nothing.nl", "cannot be read")), ([""], ("no file", ".nl")),
    (["/"], ("'/' is no file",)), (["."], ("'.' is no file",)), ([], ("usage",)),
    (["a", "b"], ("usage",)), (["STUB", "-q"], ("usage",)),
    (["STUB", "strategy=magic"], ("strategy", "magic", "scholtes")),
    (["STUB", "objno=2"], ("1 objectives", "2")),
    (["STUB", "objno=half"], ("objno", "half")),
    (["STUB", "timelimit=-1"], ("timelimit", "-1", "seconds")),
    (["STUB", "tol="], ("tol=", "name=value")),
    (["STUB", "tolerance_of_all=1"], ("tolerance_of_all",)),
])  # fmt: skip
def test_bad_calls_end_in_one_sentence(stub, capsys, words, parts):
    path = str(stub())
    assert main([path if word == "STUB" else word for word in words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert not unsaid(said.err, *parts)


def test_it_says_its_options_and_its_version(capsys):
    assert main(["-="]) == 0
    assert {"objno", "strategy", "timelimit"} <= {
        line.split()[0] for line in capsys.readouterr().out.splitlines()
    }
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
    results = pyo.SolverFactory("asl:touchstone-mpec").solve(
        model, options={"strategy": "scholtes"}
    )
    pyo.assert_optimal_termination(results)
    assert (model.x.value, model.y.value) == pytest.approx((0, 2), abs=1e-8)
    assert "scholtes" in results.solver.message
