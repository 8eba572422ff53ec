"""Plans: shapes are checked, CSV reads back bit for bit, and a bad file is told line and column."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from models.catalog import load_scene
from models.errors import TrajectoryError
from models.trajectory import Trajectory, read_csv, uniform_grid, write_csv


@pytest.fixture(scope="module")
def scene():
    return load_scene("three_cart")


@pytest.fixture
def plan() -> Trajectory:
    rng = np.random.default_rng(0)
    steps = 7
    return Trajectory(
        t=uniform_grid(0.1, steps),
        q=rng.standard_normal((steps + 1, 3)),
        v=rng.standard_normal((steps + 1, 3)),
        u=rng.standard_normal((steps, 2)),
        lam=rng.uniform(0, 1, (steps, 2)),
    )


def test_csv_reads_back_bit_for_bit(tmp_path: Path, scene, plan: Trajectory):
    path = tmp_path / "plan.csv"
    write_csv(path, plan, scene)
    back = read_csv(path, scene)
    for field in ("t", "q", "v", "u", "lam"):
        assert np.array_equal(getattr(back, field), getattr(plan, field)), field


def test_forces_and_velocities_may_be_left_out(tmp_path: Path, scene):
    path = tmp_path / "plan.csv"
    path.write_text("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n2,2,3,4,,\n")
    plan = read_csv(path, scene)
    assert plan.steps == 2
    assert np.allclose(plan.v, 1.0)
    assert not plan.lam.any()
    assert plan.missing == {"v", "lam"}


def test_velocities_left_out_are_those_of_the_time_step(tmp_path: Path, scene):
    """Semi-implicit Euler: q[t+1] = q[t] + h v[t+1]; at the task's start the task's velocities, here at rest."""
    path = tmp_path / "plan.csv"
    path.write_text("t,q1,q2,q3,u1,u3\n0,2,3,4,1,0\n0.5,2.25,3,4,1,0\n1.5,3,3,4.5,,\n")
    assert np.allclose(read_csv(path, scene).v, [[0, 0, 0], [0.5, 0, 0], [0.75, 0, 0.5]], rtol=0, atol=1e-12)


PLAIN = "t,q1,q2,q3,u1,u3\n0,0,1,2,1,0.5\n1,1,2,3,1,0\n2,2,3,4,,\n"


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace("\n", "\r\n"),
        "\ufeff" + PLAIN,
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", ";").replace("0.5", "0,5"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", " , "),
        PLAIN.replace("t,q1", '"t","q1"'),
        "# mine\n\n" + PLAIN + "\n",
        PLAIN.replace(",,", ""),
    ],
    ids=["CRLF", "BOM", "semicolons", "decimal commas", "tabs", "spaces", "quotes", "comments", "short last row"],
)
def test_what_other_programs_write_is_read(tmp_path: Path, scene, text: str):
    path = tmp_path / "plan.csv"
    path.write_bytes(text.encode())
    plan = read_csv(path, scene)
    assert plan.t.tolist() == [0.0, 1.0, 2.0]
    assert plan.q.tolist() == [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]
    assert plan.u.tolist() == [[1.0, 0.5], [1.0, 0.0]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["0 rows"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n", ["1 row;"]),
        ("t,q1,q2,q3,u1,u3,w\n0,0,1,2,1,0,1\n1,1,2,3,1,0,1\n", ["'w'", "unknown"]),
        ("t,q1,q2,q3,u1\n0,0,1,2,1\n1,1,2,3,1\n", ["'u3'", "missing"]),
        ("t,q1,q1,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'q1'", "twice"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,x,2,3,1,0\n", ["line 3", "'q1'", "'x'"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,nan,2,3,1,0\n", ["line 3, column 'q1': 'nan'", "finite"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n0,1,2,3,1,0\n", ["time must increase"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1\n", ["line 3"]),
        ("t,q1,q2,q3,u1,u3\n0,0,1,2,1,0,7\n1,1,2,3,1,0\n", ["line 2", "7 cells", "6 columns"]),
        ("# mine\n\nt,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,x,2,3,1,0\n", ["line 5", "'x'"]),
        ("0,0,1,2,1,0\n1,1,2,3,1,0\n2,1,2,3,1,0\n", ["first line holds numbers", "header"]),
        (",t,q1,q2,q3,u1,u3\n0,0,0,1,2,1,0\n1,1,1,2,3,1,0\n", ["column 1 has no name", "index=False"]),
        ("time,q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'time'", "did you mean 't'?"]),
        ("t,Q1,q2,q3,u1,u3\n0,0,1,2,1,0\n1,1,2,3,1,0\n", ["'Q1'", "did you mean 'q1'?"]),
    ],
)
def test_a_bad_file_is_told_where(tmp_path: Path, scene, text: str, words: list[str]):
    path = tmp_path / "plan.csv"
    path.write_text(text)
    with pytest.raises(TrajectoryError) as caught:
        read_csv(path, scene)
    assert str(path) in str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_file_that_is_no_text(tmp_path: Path, scene):
    path = tmp_path / "plan.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TrajectoryError, match="not text in UTF-8"):
        read_csv(path, scene)
    with pytest.raises(TrajectoryError, match=r"it cannot be read \(Is a directory\)"):
        read_csv(tmp_path, scene)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"t": np.zeros(8)}, "increase"),
        ({"q": np.zeros((7, 3))}, "q has shape"),
        ({"v": np.zeros((8, 2))}, "agree"),
        ({"u": np.full((7, 2), np.nan)}, r"u\[0, 0\]"),
    ],
)
def test_shapes_are_checked(plan: Trajectory, changes: dict, word: str):
    with pytest.raises(TrajectoryError, match=word):
        replace(plan, **changes)


def test_a_plan_of_another_scene_is_refused(scene, plan: Trajectory):
    other = replace(plan, u=np.zeros((7, 3)))
    with pytest.raises(TrajectoryError, match="u has 3 columns, but scene three_cart has 2 inputs"):
        other.check_fits(scene)


def test_arrays_cannot_be_changed_afterwards(plan: Trajectory):
    with pytest.raises(ValueError, match="read-only"):
        plan.q[0, 0] = 1.0


def test_time_is_never_a_running_sum():
    assert uniform_grid(0.1, 1000)[-1] == 100.0
