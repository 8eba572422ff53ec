"""What several pipelines of a scene begin with runs once, and gives the same numbers as if it had run in each."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from formulations.pipelines import find_pipeline, load_method
from models.catalog import load_scene
from models.trajectory_netcdf import read_netcdf
from reports.records.record import RunRecord
from validate.store.store import Store
from validate.tasks.records import planned_stages
from validate.tasks.shared_stages import Beginning, beginnings, common, must_wait, restarts, take_over

FAKES = ("--scene", "three_cart", "--tools", "shared_stages_fakes:SHARING")
# How often each method runs when everything is shared: relaxing is left to its own in `shorter`, and nothing is kept of what a clock ended.
ONCE = {"relaxing": 3 + 2, "tuning": 1, "one": 2 + 1, "two": 2 + 1 + 1, "late": 2, "cold": 1}


def _plan(name: str):
    pipeline = find_pipeline(name)
    return planned_stages(pipeline, {leg.method: load_method(leg.method) for leg in pipeline.legs})


def _key(stages) -> str:
    return "-".join(planned.name for planned in stages)


def _records(out: Path) -> dict[str, RunRecord]:
    records = [RunRecord.model_validate_json(path.read_bytes()) for path in out.glob("runs/*/record.json")]
    return {record.pipeline: record for record in records}


def _untimed(out: Path) -> list[dict[str, str]]:
    rows = csv.DictReader((out / "results.csv").read_text().splitlines())
    return [{name: value for name, value in row.items() if not name.endswith("_s")} for row in rows]


def _counted(folder: Path) -> dict[str, int]:
    return dict(Counter(path.name.partition("-")[0] for path in folder.iterdir()))


@dataclass
class Ran:
    out: Path
    counts: Path
    done: subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def fakes(cli, tmp_path_factory):
    """fakes("name", ONLY="begin+one") runs the campaign in the folder of that name and tells which methods ran."""
    base = tmp_path_factory.mktemp("shared")

    def run(name: str, *options: str, **environment: str) -> Ran:
        out, counts = base / name, base / f"{name}-counts"
        counts.mkdir(exist_ok=True)
        done = cli("all", *FAKES, "--out", str(out), "-j", "2", *options, COUNTS=str(counts), **environment)
        return Ran(out, counts, done)

    return run


@pytest.fixture(scope="module")
def whole(fakes) -> Ran:
    return fakes("whole")


def test_beginnings_end_where_a_session_does():
    plans = [
        _plan(name) for name in ("softplus_dc+strict", "softplus_dc+relu_gd", "softplus_gd+strict", "softplus_gd+relu_gd", "gd_converged")
    ]
    shared = common(plans)
    found = [[(item.stages, item.key) for item in beginnings(plan, shared, _key)] for plan in plans]
    assert found[0] == found[1] == [(3, "softplus_dc-softplus_dc-softplus_dc")]
    assert found[2] == found[3] == [(3, "softplus_gd-softplus_gd-softplus_gd")]
    assert found[4] == []
    plans[4] = plans[2][:2]  # each stage has another count, and with that a session of its own
    assert [item.stages for item in beginnings(plans[3], common(plans), _key)] == [3, 2]
    assert [item.stages for item in beginnings(plans[4], common(plans), _key)] == [2]


def test_the_same_options_are_needed():
    plans = [_plan("mpcc"), _plan("global")]
    assert [item.stages for item in beginnings(plans[1], common(plans), _key)] == [1]
    assert common([_plan("lbfgs"), _plan("randomised_smoothing")]) == frozenset()


def test_a_beginning_runs_once(whole):
    assert _counted(whole.counts) == ONCE, whole.done.stderr
    records = _records(whole.out)
    assert records["begin+picky"].outcome == "refused"
    owners = {stage.shared_from or name for name in ("begin+one", "begin+two", "begin") for stage in records[name].stages[:3]}
    assert len(owners) == 1
    first, second = (records[name].stages[2] for name in ("begin+one", "begin+two"))
    assert first.model_copy(update={"shared_from": ""}) == second.model_copy(update={"shared_from": ""})
    assert [stage.shared_from for stage in records["late+two"].stages] == ["", ""]


def test_fresh_takes_nothing_over(whole, fakes):
    shutil.copytree(whole.out, whole.out.with_name("anew"))
    again = fakes("anew", "--fresh")
    assert _counted(again.counts) == ONCE, again.done.stderr
    assert _untimed(again.out) == _untimed(whole.out)


def test_a_session_that_leaves_its_plan_is_the_beginning_of_another(whole, lost):
    """The stage in the midst and the cold one are one and the same, whichever ran first, and what follows starts from its plan."""
    for ran, owner in ((whole, "cold"), (lost, "begin+cold+two")):
        records = _records(ran.out)
        midst, cold = records["begin+cold+two"].stages[3], records["cold"].stages[0]
        assert {midst.shared_from, cold.shared_from} == {"", owner}
        assert _counted(ran.counts)["cold"] == 1
        assert midst.cost == cold.cost == 0.0  # from no plan
        assert (midst.index, cold.index) == (3, 0)
        assert midst.seconds.stage == cold.seconds.stage == cold.seconds.total
        assert [stage.cost for stage in records["begin+cold+two"].stages[4:]] == [1000.0]
        (plan,) = (ran.out / "runs" / records["begin+cold+two"].key).glob("trajectory_4.nc")
        assert read_netcdf(plan, load_scene("three_cart")).u[0, 0] == 0.0


def test_restarts_are_whole_sessions_that_others_begin_with():
    plans = [_plan(name) for name in ("strict", "relaxed+strict", "softplus_gd+strict", "softplus_gd+relu_gd")]
    shared = common(plans)
    assert [(item.stages, item.key) for item in beginnings(plans[0], shared, _key)] == [(1, "strict_lcp")]
    assert [restarts(plan, shared, _key) for plan in plans] == [(), *([(Beginning(4, "strict_lcp", 3),)] * 2), ()]
    assert all(restarts(plan, common(plans[1:]), _key) == () for plan in plans)


@pytest.fixture(scope="module")
def lost(fakes) -> Ran:
    limit = "12"
    only = "soft+falls soft+one slow+one slow+two begin+cold+two cold"
    return fakes("lost", "--time-limit", limit, "-j", "1", LIMIT=limit, ONLY=only)


def test_a_beginning_is_shared_before_what_comes_after_it(lost):
    """The cell that solved it is lost later on, and leaves it."""
    records = _records(lost.out)
    assert (records["soft+falls"].outcome, records["soft+one"].outcome) == ("crashed", "solved")
    assert _counted(lost.counts)["relaxing"] == 1 + 3
    assert records["soft+one"].stages[0].shared_from == "soft+falls"


def test_what_used_up_the_time_of_a_cell_does_so_once(lost, tmp_path):
    records = _records(lost.out)
    assert _counted(lost.counts)["slow"] == 1
    for name in ("slow+one", "slow+two"):
        assert [stage.outcome for stage in records[name].stages] == ["time_limit", "time_limit"], name
        assert "used up" in records[name].stages[1].message
    assert sorted(records[name].stages[0].shared_from for name in ("slow+one", "slow+two"))[0] == ""
    (late,) = (path.name for path in (lost.out / "stages").iterdir() if path.name.endswith("s"))
    folder = tmp_path / "runs" / "cell"
    folder.mkdir(parents=True)
    shutil.copytree(lost.out / "stages", tmp_path / "stages")
    wanted, scene = (Beginning(1, late.rpartition("-")[0]),), load_scene("three_cart")
    assert take_over(wanted, scene, 2, folder, 12.0).late
    assert take_over(wanted, scene, 2, folder, 24.0).stages == ()  # with more time it is run again
    assert not must_wait(wanted, [wanted], Store(tmp_path), 12.0)
    assert must_wait(wanted, [wanted], Store(tmp_path), 24.0)


def test_the_time_of_a_pipeline_is_that_of_its_stages_wherever_they_ran(whole):
    for record in _records(whole.out).values():
        total = 0.0
        for stage in record.stages:
            total += stage.seconds.stage
            assert stage.seconds.total == (pytest.approx(total) if stage.seconds.stage else 0.0)
        own = sum(stage.seconds.stage for stage in record.stages if not stage.shared_from)
        spent = sum(record.profile.get(name, 0.0) for name in ("build", "translate", "evaluate", "linear_algebra", "solve_rest"))
        assert own <= spent + 1e-3  # the profile is of what ran here, and of nothing else


def test_the_numbers_are_those_of_cells_that_share_nothing(whole, fakes):
    names = ["begin+one shorter late+one", "begin+tune+two"]
    apart = [fakes(f"apart{number}", ONLY=only) for number, only in enumerate(names)]
    assert not any((ran.out / "stages").exists() for ran in apart)
    rows = [row for ran in apart for row in _untimed(ran.out)]
    assert len(rows) == 4 + 2 + 2 + 5
    together = _untimed(whole.out)
    assert all(row in together for row in rows)


@pytest.mark.parametrize("method", ["relaxing", "two"])
def test_killed_in_between_and_resumed(whole, fakes, method):
    """In the midst of the beginning, and in what comes after it, which is then run from files."""
    only = "begin+one begin+two begin+tune+two"
    ran = fakes(f"killed_{method}", KILL=method, ONLY=only)
    assert ran.done.returncode == -9
    begun = _counted(ran.counts)[method]  # one, or two where both cells had come so far
    again = fakes(f"killed_{method}", KILL=method, ONLY=only)
    assert again.done.returncode == 0, again.done.stderr
    together = [row for row in _untimed(whole.out) if row["pipeline"] in only.split()]
    assert _untimed(again.out) == together
    assert _counted(again.counts)[method] - begun == {"relaxing": 3, "two": 2}[method]
    assert {path.name for path in (again.out / "runs").iterdir()} == {record.key for record in _records(again.out).values()}


def _of_three_stages(out: Path) -> str | None:
    """The key of a beginning of three stages that the campaign in `out` shares."""
    kept = sorted((out / "stages").iterdir())
    return next((path.name for path in kept if (path / "trajectory_3.nc").exists() and not (path / "trajectory_4.nc").exists()), None)


def _taken(out: Path, stages: int, folder: Path, key: str | None):
    """What a cell of so many stages would take over of it; None if it is no longer there."""
    folder.mkdir(parents=True, exist_ok=True)
    is_there = key is not None and (out / "stages" / key).exists()
    return take_over((Beginning(3, key),), load_scene("three_cart"), stages, folder) if is_there else None


@pytest.mark.parametrize("damage", ["content", "plan", "missing", "empty", "another"])
def test_a_damaged_beginning_is_put_aside(whole, tmp_path, damage):
    shutil.copytree(whole.out / "stages", tmp_path / "stages")
    folder = tmp_path / "runs" / "cell"
    key = _of_three_stages(tmp_path)
    good = _taken(tmp_path, 4, folder, key)
    assert good is not None
    assert key is not None
    assert len(good.stages) == 3
    stored = tmp_path / "stages" / key
    content = json.loads((stored / "stages.json").read_text())
    if damage == "content":
        (stored / "stages.json").write_text(json.dumps({**content, "stages": content["stages"][:2]}))
    elif damage == "plan":
        (stored / "trajectory_3.nc").write_bytes((stored / "trajectory_3.nc").read_bytes()[:-1] + b"x")
    elif damage == "missing":
        (stored / "trajectory_2.nc").unlink()
    elif damage == "empty":
        (stored / "stages.json").write_text("")
    else:
        (stored / "stages.json").write_text(json.dumps({**content, "key": "0" * 64}))
    found = _taken(tmp_path, 4, folder, key)
    assert found is not None
    assert found.stages == ()
    assert _taken(tmp_path, 4, folder, key) is None  # no cell meets it again


def test_plans_of_stages_taken_over_lie_in_the_cell(whole):
    scene = load_scene("three_cart")
    for name in ("begin+one", "begin+two", "begin"):
        record = _records(whole.out)[name]
        folder = whole.out / "runs" / record.key
        plans = [f"trajectory_{number}.nc" for number in range(1, len(record.stages))] + ["trajectory.nc"]
        assert sorted(path.name for path in folder.glob("trajectory*.nc")) == sorted(plans)
        assert [read_netcdf(folder / plan, scene).u[0, 0] for plan in plans] == list(range(len(plans)))
        assert not list(folder.glob("sharing*"))


def test_a_stored_beginning_is_waited_for_by_nobody(tmp_path):
    store, mine, theirs = Store(tmp_path), (Beginning(3, "long"), Beginning(1, "short")), (Beginning(1, "short"),)
    assert must_wait(mine, [(), theirs], store)
    assert not must_wait(mine, [(), (Beginning(2, "other"),)], store)
    (store.stages / "short").mkdir(parents=True)
    assert not must_wait(mine, [theirs], store)
