"""Real cells: solved, replayed through the FMU, scored, told; and the same again, bit for bit."""

import csv
import subprocess
import sys

import pytest

from models.catalog import load_scene
from models.results.run import RunRecord
from models.results.stored import from_json
from models.trajectory import write_csv
from models.trajectory_netcdf import read_netcdf
from reports.pages.section import run_pages
from reports.traces import read_motion

pytestmark = [pytest.mark.slow, pytest.mark.whole]

CHOICE = ("all", "--scene", "three_cart", "-k", "softplus_gd+relu_gd")


@pytest.fixture(scope="module")
def twice(cli, cli_environment, tmp_path_factory):
    """The second in a process of its own, which orders its sets otherwise."""
    first, second = folders = [tmp_path_factory.mktemp(name) for name in ("first", "second")]
    command = [sys.executable, "-m", "validate", *CHOICE, "--out", str(second)]
    alone = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env={**cli_environment, "PYTHONHASHSEED": "7"},
        check=False,
    )
    return folders, [cli(*CHOICE, "--out", str(first)), alone]


def _rows(folder) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def test_results_are_equal_to_the_bit_apart_from_times(twice):
    (first, second), _ = twice
    rows = [
        [
            {name: value for name, value in row.items() if not name.endswith("_s")}
            for row in _rows(folder)
        ]
        for folder in (first, second)
    ]
    assert rows[0] == rows[1]
    assert len(rows[0]) == 4


def test_the_papers_costs_come_out(twice):
    (first, _), done = twice
    assert done[0].returncode == 0, done[0].stderr + done[0].stdout
    assert [float(row["cost"]) for row in _rows(first)] == pytest.approx(
        [149.17, 166.45, 215.14, 309.42], abs=0.02
    )
    assert [row["verdict"] for row in _rows(first)] == ["violates", "violates", "violates", "holds"]
    assert _rows(first)[-1]["physics"] == "0.0"


def test_the_second_run_finds_the_first(twice, cli):
    (first, _), _ = twice
    again = cli(*CHOICE, "--out", str(first))
    assert again.stderr.splitlines()[0] == "1 stored, 0 to run"
    before = (first / "results.csv").read_bytes()
    cli("report", str(first))
    assert (first / "results.csv").read_bytes() == before


def test_the_folder_holds_everything(twice):
    (first, _), _ = twice
    (path,) = first.glob("runs/*/record.json")
    record = from_json(RunRecord, path.read_bytes())
    names = {item.name for item in path.parent.iterdir()}
    plans = {
        f"{kind}{stage}.nc" for kind in ("trajectory", "replay") for stage in ("", "_1", "_2", "_3")
    }
    assert names == {"record.json", "log.txt", "task.json", "files.json", *plans}
    last = record.stages[-1]
    assert last.paper == {"cost": 309.42, "stability": 0.05, "physics": 0.21, "time": 2.38}
    assert last.replay.error_estimate <= 1e-8
    motion = read_motion(path.parent, record, last)
    assert motion.problems == ()
    for trace in (motion.plan, motion.replay):
        assert len(trace.t) <= 1500
        assert trace.columns.keys() >= {"q1", "u1", "lam_left", "gap_left"} - (
            {"u1"} if trace is motion.replay else set()
        )
        assert set(trace.poses) == {"left", "middle", "right"}
        gap = trace.columns["q2"] - trace.columns["q1"] - 0.5
        assert trace.columns["gap_left"] == pytest.approx(
            gap, abs=1e-5
        )  # of positions of some metres, 6 digits
    assert motion.replay.columns["position_error"].max() == pytest.approx(
        last.metric("replay_error").value, rel=4e-6
    )
    assert last.seconds.total == pytest.approx(sum(stage.seconds.wall for stage in record.stages))
    assert (first / "report.html").stat().st_size > 10_000
    assert (first / "pages" / run_pages([record])[record.key]).stat().st_size > 50_000


def test_a_stored_plan_scores_the_same_from_outside(twice, cli, tmp_path):
    (first, _), _ = twice
    (stored,) = first.glob("runs/*/trajectory.nc")
    scene = load_scene("three_cart")
    write_csv(tmp_path / "plan.csv", read_netcdf(stored, scene), scene)
    done = cli("replay", str(tmp_path / "plan.csv"), "--scene", "three_cart")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("holds: ")
