"""Plans: shapes are checked, CSV reads back bit for bit, and a bad file is told line and column."""

from dataclasses import replace
from datetime import timedelta
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from wording import saying, unsaid

from models.catalog import load_scene
from models.errors import TrajectoryError
from models.plan_table import ArrayTable
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, read_csv, trajectory_from, uniform_grid, write_csv

PLAIN = "t,q1,q2,q3,u1,u3\n0,0,1,2,1,0.5\n1,1,2,3,1,0\n2,2,3,4,,\n"


@pytest.fixture(scope="module")
def scene():
    return load_scene("three_cart")


@pytest.fixture
def plan() -> Trajectory:
    rng = np.random.default_rng(0)
    steps = 7
    return Trajectory(
        t=uniform_grid(0.1, steps), q=rng.standard_normal((steps + 1, 3)),
        v=rng.standard_normal((steps + 1, 3)), u=rng.standard_normal((steps, 2)),
        lam=rng.uniform(0, 1, (steps, 2)),
    )  # fmt: skip


@pytest.fixture
def reading(tmp_path: Path, scene):
    """reading(text, ..): the plan of a file of such words."""
    path = tmp_path / "plan.csv"

    def read(text: str, **options) -> Trajectory:
        path.write_bytes(text.encode())
        return read_csv(path, scene, **options)

    return read


@pytest.mark.parametrize("scheme", [None, *Scheme])
@pytest.mark.parametrize("silent", [(), ("lam",), ("v", "lam"), ("q", "v", "lam")])
def test_csv_keeps_a_plan_bit_for_bit_with_what_it_declares_and_what_it_does_not_say(
    tmp_path: Path, scene, plan: Trajectory, scheme, silent
):
    path = tmp_path / "plan.csv"
    write_csv(path, replace(plan, scheme=scheme, missing=frozenset(silent)), scene)
    back = read_csv(path, scene)
    assert (back.scheme, back.hold, back.missing) == (scheme, Hold.ZERO_ORDER, frozenset(silent))
    for field in {"t", "q", "v", "u", "lam"} - {*silent}:
        assert np.array_equal(getattr(back, field), getattr(plan, field)), field
    header = next(line for line in path.read_text().splitlines() if not line.startswith("#"))
    assert ("q1" in header, "lam_left" in header) == ("q" not in silent, "lam" not in silent)


def test_csv_keeps_a_linear_hold_and_its_last_input(tmp_path: Path, scene, plan: Trajectory):
    path, end = tmp_path / "plan.csv", np.array([0.1, 0.7])
    for u_end in (end, None):
        write_csv(path, replace(plan, hold=Hold.LINEAR, u_end=u_end), scene)
        back = read_csv(path, scene)
        assert back.hold is Hold.LINEAR
        assert (back.u_end is None) if u_end is None else np.array_equal(back.u_end, end)
        assert np.array_equal(back.u, plan.u)


def test_forces_and_velocities_may_be_left_out(reading):
    plan = reading(PLAIN)
    assert plan.steps == 2
    assert np.allclose(plan.v[1:], 1.0)
    assert not plan.lam.any()
    assert plan.missing == {"v", "lam"}


def test_velocities_left_out_are_central_differences(reading):
    """The parabola through the rows; at the start the task's velocities, here at rest."""
    plan = reading("t,q1,q2,q3,u1,u3\n0,2,3,4,1,0\n0.5,2.25,3,4,1,0\n1.5,4.25,3,4.5,,\n")
    assert np.allclose(plan.v[:, 0], [0.0, 1.0, 3.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("text", [
    PLAIN.replace("\n", "\r\n"), "\ufeff" + PLAIN, PLAIN.replace(",", ";"),
    PLAIN.replace(",", ";").replace("0.5", "0,5"), PLAIN.replace(",", "\t"),
    PLAIN.replace(",", " , "), PLAIN.replace("t,q1", '"t","q1"'), "# mine\n\n" + PLAIN + "\n",
    PLAIN.replace(",,", ""), PLAIN.replace("\n", ",\n"), PLAIN.replace("t,", "Time,", 1),
    PLAIN.replace("t,q1", "t (s),q1 (m)", 1),
],
ids=["CRLF", "BOM", "semicolons", "decimal commas", "tabs", "spaces", "quotes", "comments",
     "short last row", "commas at the end", "time", "units in brackets"])  # fmt: skip
def test_csv_of_other_programs_is_read(reading, text: str):
    plan = reading(text)
    assert plan.t.tolist() == [0.0, 1.0, 2.0]
    assert plan.q.tolist() == [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]
    assert plan.u.tolist() == [[1.0, 0.5], [1.0, 0.0]]


@pytest.mark.parametrize(("text", "words"), [
    ("", ["0 rows"]), ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n", ["1 row;"]),
    ("t,q1,q2,q3,u1,u3,w\n0,0,1,2,1,0,1\n1,1,2,3,1,0,1\n", ["'w'", "unknown"]),
    ("t,q1,q2,q3,u1\n0,0,1,2,1\n1,1,2,3,1\n", ["'u3'", "missing"]),
    ("t,q1,q1,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'q1'", "twice"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,x,2,3,1,0\n", ["line 3", "'q1'", "'x'"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,nan,2,3,1,0\n", ["line 3, column 'q1': 'nan'", "finite"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n0,1,2,3,1,0\n", ["time must increase", "two rows have the time 0", "jump"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1\n", ["line 3"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0,7\n1,1,2,3,1,0\n", ["line 2", "7 cells", "6 columns"]),
    ("# mine\n\nt,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,x,2,3,1,0\n", ["line 5", "'x'"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1_0,2,3,1,0\n",
     ["line 3, column 'q1': '1_0' is not a number"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,٣,2,3,1,0\n", ["line 3, column 'q1': '٣' is not a number"]),
    ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1e999,2,3,1,0\n",
     ["line 3, column 'q1': '1e999' is not a finite number"]),
    ("0,0,1,2,1,0\n1,1,2,3,1,0\n2,1,2,3,1,0\n", ["first line holds numbers", "header"]),
    (",t,q1,q2,q3,u1,u3\n0,0,0,1,2,1,0\n1,1,1,2,3,1,0\n", ["column 1 has no name", "index=False"]),
    ("zeit,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'zeit'", "unknown"]),
    ("t,q1,q2,,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["column 4 has no name", "delete it"]),
    ("t,Q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'Q1'", "did you mean 'q1'?"]),
    ("t,q1,q2,q3,u1 (kN),u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["the column 'u1' is in 'kN', but 'N' is expected"]),
])  # fmt: skip
def test_bad_csv_names_line_and_column(tmp_path: Path, reading, text: str, words: list[str]):
    with pytest.raises(TrajectoryError) as caught:
        reading(text)
    assert not unsaid(caught.value, str(tmp_path / "plan.csv"), *words)


@pytest.mark.parametrize(("above", "scheme", "hold"), [
    ("", None, Hold.ZERO_ORDER),
    ("# scheme: semi_implicit_euler\n", Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER),
    ("#scheme = semi_implicit_euler \n# hold: zero\n", Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER),
    ("# hold: linear\n", None, Hold.LINEAR),
    ("# Hold: linear\n", None, Hold.LINEAR),
    ("  # scheme: semi_implicit_euler\n", Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER),
    ('"# scheme: semi_implicit_euler"\n', Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER),
    ('"# scheme: semi_implicit_euler",,,\n"# mine",,\n', Scheme.SEMI_IMPLICIT_EULER,
     Hold.ZERO_ORDER),
    ("\t# hold: linear;;;\n", None, Hold.LINEAR),
    ("# hold the line\n# scheme of mine\n# hold\n# scheme\n# hold zero or linear\n", None,
     Hold.ZERO_ORDER),
    ("# made by: me\n# on: Monday\n# a plan; hold your breath\n", None,
     Hold.ZERO_ORDER),  # any other comment is a comment
])  # fmt: skip
def test_comments_declare_scheme_and_hold(reading, above: str, scheme, hold):
    plan = reading(above + PLAIN)
    assert (plan.scheme, plan.hold) == (scheme, hold)


@pytest.mark.parametrize(
    ("above", "words"),
    [
        ("# sheme: semi_implicit_euler\n", "line 1: … no 'sheme' … did you mean 'scheme'?"),
        ("# mine\n# holds: zero\n", "line 2: … no 'holds' … did you mean 'hold'?"),
        (
            "# scheme semi_implicit_euler\n",
            "line 1: '# scheme semi_implicit_euler' declares nothing; write '# scheme: semi_implicit_euler'.",
        ),
        (
            "# mine\n# Hold  linear\n",
            "line 2: '# Hold  linear' declares nothing; write '# hold: linear'.",
        ),
        (
            "# scheme: semi_implicit_eular\n",
            "scheme 'semi_implicit_eular' … did you mean semi_implicit_euler?",
        ),
        ("# scheme: my own\n", "scheme 'my own' … there are semi_implicit_euler,"),
        ("# scheme: my own\n", "without this line it declares none"),
        ("# hold: cubic\n", "hold 'cubic' … zero or linear"),
        ("# hold: zero\n# hold: linear\n", "line 2: … hold 'linear', but 'zero' before"),
        ("# scheme: semi_implicit_euler\n# hold: linear\n", "the plan's hold is linear; leave one"),
    ],
)
def test_a_declaration_that_is_none_is_refused(tmp_path: Path, reading, above: str, words: str):
    with pytest.raises(TrajectoryError) as caught:
        reading(above + PLAIN)
    assert not unsaid(caught.value, str(tmp_path / "plan.csv"), words)


@pytest.mark.parametrize("place", [1, 2, -1])
@pytest.mark.parametrize("text", ["# hold: linear", "# scheme: semi_implicit_euler"])
def test_a_declaration_below_the_header_is_refused(reading, place: int, text: str):
    lines = PLAIN.splitlines()
    lines.insert(len(lines) if place < 0 else place, text)
    with pytest.raises(TrajectoryError, match="stands below the header; move it above"):
        reading("\n".join(lines) + "\n")
    lines[lines.index(text)] = "# a comment, hold: linear"
    assert reading("\n".join(lines) + "\n").hold is Hold.ZERO_ORDER


def test_columns_are_ignored_by_name(tmp_path: Path, scene):
    """Numbers or not, at the end or between others; the rest is read as without them."""
    (tmp_path / "plan.csv").write_text(PLAIN, encoding="utf-8")
    plain = read_csv(tmp_path / "plan.csv", scene)
    rows = [line.split(",") for line in PLAIN.splitlines()]
    odd = [["why", *rows[0][:2], "note", *rows[0][2:]]]
    odd += [["-", *row[:2], "", *row[2:]] for row in rows[1:]]
    (tmp_path / "odd.csv").write_text("\n".join(map(",".join, odd)) + "\n", encoding="utf-8")
    with pytest.raises(TrajectoryError, match=r"'why' is unknown.*--ignore why"):
        read_csv(tmp_path / "odd.csv", scene)
    read = read_csv(tmp_path / "odd.csv", scene, ignore=("why", "note"))
    assert (read.q.tolist(), read.u.tolist()) == (plain.q.tolist(), plain.u.tolist())
    with pytest.raises(TrajectoryError, match="there is no column 'nothing' to ignore; it has why"):
        read_csv(tmp_path / "odd.csv", scene, ignore=("nothing",))


def test_the_last_row_twice_is_told_by_its_time(reading):
    lines = PLAIN.splitlines()
    with pytest.raises(TrajectoryError, match="time must increase, but two rows have the time"):
        reading("\n".join([*lines, lines[-1]]) + "\n")


def test_hold_and_scheme_must_agree_with_declarations(reading):
    assert reading("# hold: zero\n" + PLAIN, hold=Hold.ZERO_ORDER).hold is Hold.ZERO_ORDER
    with pytest.raises(TrajectoryError, match="'zero', but --hold requests"):
        reading("# hold: zero\n" + PLAIN, hold=Hold.LINEAR)
    with pytest.raises(TrajectoryError, match="'semi_implicit_euler' is requested; leave one"):
        reading(f"# scheme: {list(Scheme)[1].value}\n" + PLAIN, scheme="semi_implicit_euler")
    assert reading(PLAIN, hold=Hold.LINEAR).hold is Hold.LINEAR
    assert reading(PLAIN, scheme="semi_implicit_euler").scheme is Scheme.SEMI_IMPLICIT_EULER


@pytest.mark.parametrize(("header", "words"), [
    ("t,q1,q2,u1,u3", "'q3' is missing, but 'q1' is present; give q1, q2, q3, or none"),
    ("t,q1,q2,q3,v1,u1,u3", "'v2' is missing, but 'v1' is present; give v1, v2, v3, or none"),
    ("t,u1,u3,lam_right", "the column 'lam_left' is missing, but 'lam_right' is present"),
    ("t,v1,v2,v3,u1,u3", "no positions; give q1, q2, q3 too"),
])  # fmt: skip
def test_half_a_group_of_columns_is_refused(reading, scene, header: str, words: str):
    columns = header.split(",")
    rows = [",".join([str(row), *["1"] * (len(columns) - 1)]) for row in range(3)]
    with pytest.raises(TrajectoryError, match=saying(words)):
        reading("\n".join([header, *rows]) + "\n")
    with pytest.raises(TrajectoryError, match=saying(words)):
        trajectory_from(ArrayTable({name: np.arange(3.0) for name in columns}), scene)


def test_empty_columns_are_as_none(reading, scene):
    """As a spreadsheet, or pandas, writes what is not known."""
    plan = reading(
        "t,q1,q2,q3,v1,v2,v3,u1,u3,lam_left,lam_right\n0,0,1,2,,,,1,0,,\n1,1,2,3,,,,1,0,,\n2,2,3,4,,,,,\n"
    )
    assert (plan.steps, plan.missing) == (2, {"v", "lam"})
    nothing = dict.fromkeys(("q1", "q2", "q3", "lam_left"), np.full(3, np.nan)) | {
        "lam_right": [None] * 3
    }
    plan = trajectory_from(
        ArrayTable({"t": np.arange(3.0), "u1": np.ones(2), "u3": np.ones(2)} | nothing), scene
    )
    assert (plan.missing, plan.q[-1].tolist()) == ({"q", "v", "lam"}, list(scene.task.start[:3]))
    with pytest.raises(TrajectoryError, match="the column 'u3' is empty; it has t, u1"):
        reading("t,u1,u3\n0,1,\n1,1,\n")
    with pytest.raises(
        TrajectoryError,
        match="the column 'q3' is empty, but 'q1' is present; give q1, q2, q3, or none",
    ):
        reading("t,q1,q2,q3,u1,u3\n0,0,1,,1,0\n1,1,2,,1,0\n")


@pytest.mark.parametrize("last", [True, False])
def test_inputs_alone_last_as_long_as_the_task_with_and_without_a_final_time(
    reading, scene, last: bool
):
    """five hundred inputs at 0, 0.01 ..

    4.99 s: the last is held for one step more, whether or not 5 s stands there without one.
    """
    task = scene.task
    rows = [f"{task.step * n!r},{n % 3},{-(n % 2)}" for n in range(task.steps)] + [
        f"{task.horizon!r},,"
    ] * last
    plan = reading("\n".join(["t,u1,u3", *rows]) + "\n")
    assert plan.steps == task.steps
    assert plan.duration == pytest.approx(task.horizon, abs=1e-12)
    assert plan.u[-1].tolist() == [(task.steps - 1) % 3, -((task.steps - 1) % 2)]
    assert plan.missing == {"q", "v", "lam"}
    assert np.array_equal(plan.q, np.tile(task.start[:3], (task.steps + 1, 1))), (
        "it stands in for the start alone"
    )
    arrays = {"t": plan.t[: task.steps + last], "u1": plan.u[:, 0], "u3": plan.u[:, 1]}
    again = trajectory_from(ArrayTable(arrays), scene)
    assert np.array_equal(again.t, plan.t)
    assert np.array_equal(again.u, plan.u)


def test_inputs_at_both_ends_of_the_last_step_need_no_step_more(reading, scene):
    task = scene.task
    text = (
        "\n".join(
            [
                "# hold: linear",
                "t,u1,u3",
                *(f"{task.step * n!r},{n},0" for n in range(task.steps + 1)),
            ]
        )
        + "\n"
    )
    plan = reading(text)
    assert plan.steps == task.steps
    assert plan.u_end.tolist() == [task.steps, 0.0]
    text = text.replace("linear", "zero")
    held = reading(text)
    assert (held.steps, held.u_end.tolist()) == (
        task.steps,
        [task.steps, 0.0],
    )  # kept, for who should have said `linear`
    text = text.replace(
        f"{task.step * task.steps!r},{task.steps},0", f"{task.step * task.steps!r},x,0"
    )
    assert reading(text).u_end is None, "a held input has no use for what stands there"


ARRAYS = {
    "t": np.arange(4.0),
    "q1": np.arange(4.0),
    "q2": np.arange(4.0),
    "q3": np.arange(4.0),
    "u1": np.ones(4),
    "u3": np.ones(3),
}


@pytest.mark.parametrize("changes", [
    {}, {"u1": np.array([1.0, 1.0, 1.0, np.nan])}, {"u1": [1, 1, 1]}, {"q1": (0, 1, 2, 3)},
    {"u1": [True, True, True]},
    {"u1": np.array([1, Decimal(1), "1.0", None], dtype=object)},
    {"q1": ["0", " 1 ", "2.", "+3e0"]}, {"q1": np.ma.masked_array(np.arange(4.0))},
    {"u1": torch.ones(3, requires_grad=True), "q1": torch.arange(4.0)},
    {"q1": np.arange(4.0)[:, None], "u1": np.ones((1, 3))},
],
ids=["as long as t", "ends in NaN", "one shorter", "no array", "truth", "objects", "text",
     "a mask that masks nothing", "tensors", "columns of a matrix"])  # fmt: skip
def test_arrays_by_name_are_a_plan(scene, changes: dict):
    plan = trajectory_from(ArrayTable(ARRAYS | changes, scheme="semi_implicit_euler"), scene)
    assert (plan.steps, plan.scheme, plan.missing) == (3, Scheme.SEMI_IMPLICIT_EULER, {"v", "lam"})
    assert plan.q[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert plan.u.tolist() == [[1.0, 1.0]] * 3


@pytest.mark.parametrize(("changes", "words"), [
    ({"q2": np.arange(3.0)}, "the column 'q2' has 3 numbers, but t has 4"),
    ({"u1": np.ones(2)}, "the column 'u1' has 2 numbers, but t has 4"),
    ({"q2": np.array([0.0, np.nan, 2.0, 3.0])}, "'q2', row 1: nan"),
    ({"q2": np.zeros((4, 2))}, "the column 'q2' has shape (4, 2)"),
    ({"q2": ["a", "b", "c", "d"]}, "'q2' … real numbers … 'a'"),
    ({"q2": ["0", "1_0", "2", "3"]}, "'q2' … real numbers … '1_0'"),
    ({"q2": np.arange(4) + 5j}, "'q2' … complex128 … real numbers"),
    ({"q2": np.array([1j, 1, 2, 3], dtype=object)}, "'q2' … real numbers … 1j"),
    ({"t": np.arange(4).astype("timedelta64[ms]")}, "the column 't' is of type timedelta64[ms]"),
    ({"t": np.arange(4).astype("datetime64[ms]")}, "the column 't' is of type datetime64[ms]"),
    ({"t": np.array([timedelta(seconds=n) for n in range(4)])},
     "'t' … real numbers … datetime.timedelta(0)"),
    ({"q2": np.ma.masked_equal(np.arange(4.0), 2.0)}, "the column 'q2' has masked values"),
    ({"q2": [[1.0], 2.0, 3.0, 4.0]}, "'q2' … rows of equal length"),
    ({0: np.zeros(4)}, "called 0 … must be text"),
    ({"q4": np.zeros(4)}, "the column 'q4' is unknown"),
    ({"t": np.zeros(1)}, "1 row; at least two"),
])  # fmt: skip
def test_wrong_arrays_are_named(scene, changes: dict, words: str):
    with pytest.raises(TrajectoryError, match=saying(words)):
        trajectory_from(ArrayTable(ARRAYS | changes), scene)


def test_time_may_be_the_index_and_columns_fields(scene):
    full = {name: np.append(values, np.nan)[:4] for name, values in ARRAYS.items()}
    fields = np.zeros(4, dtype=[(name, float) for name in full])
    for name, values in full.items():
        fields[name] = values
    frame = pd.DataFrame(full).set_index("t")
    for plan in (frame, fields, fields.view(np.recarray)):
        assert trajectory_from(ArrayTable(plan), scene).q[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]
    with pytest.raises(TrajectoryError, match=r"reset_index\(names='t'\)"):
        ArrayTable(frame.rename_axis("seconds"))
    with pytest.raises(TrajectoryError, match=r"shape \(4, 2\) has no column names"):
        ArrayTable(np.zeros((4, 2)))


@pytest.mark.parametrize("name", ["time", "Time"])
def test_array_table_column_or_index_time_is_read_as_t(scene, name: str):
    columns = {name if key == "t" else key: values for key, values in ARRAYS.items()}
    full = {key: np.append(values, np.nan)[:4] for key, values in columns.items()}
    for plan in (columns, pd.DataFrame(full), pd.DataFrame(full).set_index(name)):
        assert trajectory_from(ArrayTable(plan), scene).t.tolist() == ARRAYS["t"].tolist()


def test_array_table_time_beside_t_is_refused(scene):
    with pytest.raises(TrajectoryError, match="the column 'time' is unknown"):
        trajectory_from(ArrayTable(ARRAYS | {"time": ARRAYS["t"]}), scene)


def test_arrays_without_time_are_refused(scene):
    with pytest.raises(TrajectoryError, match="the column 't' is missing"):
        trajectory_from(
            ArrayTable({name: values for name, values in ARRAYS.items() if name != "t"}), scene
        )


def test_a_file_that_is_no_text(tmp_path: Path, scene):
    path = tmp_path / "plan.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TrajectoryError, match="not text in UTF-8"):
        read_csv(path, scene)
    with pytest.raises(TrajectoryError, match="it is a folder; a plan is a CSV file; of a scene"):
        read_csv(tmp_path, scene)


def test_a_file_of_another_kind_is_called_what_it_is(tmp_path: Path, scene):
    path, kinds = (
        tmp_path / "plan.csv",
        {
            b"\xef\xbb\xbf\n <!doctype html>\n<p>\n": "HTML or XML",
            b'{"t": [0],\n"u1": [1],\n': "JSON",
            b"[[0, 1],\n [1, 2]]": "JSON",
        },
    )
    np.savez(tmp_path / "plan.npz", t=np.arange(3.0))
    np.save(tmp_path / "plan.npy", np.arange(3.0))
    kinds |= {
        (tmp_path / "plan.npz").read_bytes(): "a zip archive, as .npz",
        (tmp_path / "plan.npy").read_bytes(): "an array of NumPy",
    }
    for data, words in kinds.items():
        path.write_bytes(data)
        with pytest.raises(
            TrajectoryError,
            match=saying(
                f"plan {path}: it is {words} … a plan is a CSV file; … not of an FMU, also … NetCDF file called .nc"
            ),
        ):
            read_csv(path, scene)


@pytest.mark.parametrize(("changes", "word"), [
    ({"t": np.zeros(8)}, "increase"), ({"q": np.zeros((7, 3))}, "q has shape"),
    ({"v": np.zeros((8, 2))}, "agree"),
    ({"u": np.full((7, 2), np.nan)}, r"u\[0, 0\]"), ({"u_end": np.zeros(3)}, "u_end has shape"),
    ({"scheme": Scheme.SEMI_IMPLICIT_EULER, "hold": Hold.LINEAR},
     "holds its inputs over each step"),
    ({"scheme": "rk4"}, "the scheme 'rk4' is unknown; there are semi_implicit_euler"),
    ({"scheme": ["radau_iia_2"]}, "the scheme .* is unknown"),
    ({"hold": "cubic"}, "the hold 'cubic'.*zero or linear"),
    ({"hold": None}, "the hold None.*zero or linear"),
    ({"missing": None}, "missing is None.*'q', 'v', 'lam', 'friction', or empty"),
    ({"missing": "lam"}, "missing is 'lam', but must be a set"),
    ({"missing": {"foo"}}, "missing is {'foo'}, but must be a set"),
    ({"missing": [["q"]]}, "missing is .*, but must be a set"),
    ({"q": np.full((8, 3), 1j)}, "q is of type complex128"),
    ({"u": "fast"}, "u must be real numbers, but holds 'fast'"),
])  # fmt: skip
def test_shapes_are_checked(plan: Trajectory, changes: dict, word: str):
    with pytest.raises(TrajectoryError, match=word):
        replace(plan, **changes)


@pytest.mark.parametrize("field", ["t", "q", "v", "u", "lam"])
def test_a_value_not_finite_or_a_field_too_short_is_refused_by_name(plan: Trajectory, field: str):
    for value in (np.nan, np.inf):
        spoiled = np.array(getattr(plan, field))
        spoiled[3] = value
        with pytest.raises(TrajectoryError, match=rf"{field}\[3(, 0)?\] is {value}"):
            replace(plan, **{field: spoiled})
    with pytest.raises(TrajectoryError, match="q has shape" if field == "t" else f"{field} has"):
        replace(plan, **{field: getattr(plan, field)[:-1]})


def test_hold_and_scheme_may_be_text(plan: Trajectory):
    assert replace(plan, scheme="radau_iia_2").scheme is Scheme.RADAU_IIA_2
    assert replace(plan, hold="linear").hold is Hold.LINEAR
    assert replace(plan, hold="zero", missing=["lam", "v"]).missing == {"lam", "v"}


def test_a_plan_of_another_scene_is_refused(scene, plan: Trajectory):
    other = replace(plan, u=np.zeros((7, 3)))
    with pytest.raises(TrajectoryError, match="u has 3 columns, but scene three_cart has 2 inputs"):
        other.check_fits(scene)


@pytest.mark.parametrize("scheme", Scheme)
def test_a_scheme_that_the_scene_does_not_have_is_refused_where_the_two_meet(
    tmp_path: Path, scheme: Scheme
):
    """Friction has no collocation step, whoever reads the plan."""
    rubbing, path = load_scene("hopper_planar"), tmp_path / "plan.csv"
    t = uniform_grid(rubbing.task.step, rubbing.task.steps)
    columns = {"t": t} | {item.name: np.zeros(len(t) - 1) for item in rubbing.inputs}
    rows = [
        "t," + ",".join(item.name for item in rubbing.inputs),
        "0" + ",0" * rubbing.nu,
        "1" + "," * rubbing.nu,
    ]
    path.write_text(f"# scheme: {scheme.value}\n" + "\n".join(rows) + "\n")
    bare = replace(trajectory_from(ArrayTable(columns), rubbing), scheme=scheme)
    readers = (
        lambda: bare.check_fits(rubbing),
        lambda: trajectory_from(ArrayTable(columns, scheme=scheme.value), rubbing),
        lambda: read_csv(path, rubbing),
    )  # fmt: skip
    for read in readers:
        if scheme is Scheme.SEMI_IMPLICIT_EULER:
            read()
        else:
            with pytest.raises(
                TrajectoryError, match=f"scheme {scheme.value}, .*hopper_planar.*semi_implicit"
            ):
                read()


def test_arrays_cannot_be_changed_afterwards(plan: Trajectory):
    with pytest.raises(ValueError, match="read-only"):
        plan.q[0, 0] = 1.0


def test_time_is_never_a_running_sum():
    assert uniform_grid(0.1, 1000)[-1] == 100.0
