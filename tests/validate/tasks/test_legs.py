"""A leg that several pipelines of a scene have runs once, and gives the same numbers as if it had run in each."""

import gzip
import json
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from killed_campaigns import records, untimed

from formulations.method import Leg, Pipeline
from formulations.pipelines import find_pipeline, load_method
from models.catalog import load_scene
from models.results.stored import to_data
from models.trajectory_netcdf import read_netcdf
from validate.tasks.leg import (
    PlannedLeg,
    legs_in,
    place,
    planned_legs,
    planned_stages,
    take,
)

pytestmark = pytest.mark.slow

FAKES = ("--scene", "three_cart", "--plugin", "leg_fakes:SHARING")
# How often each method runs when everything is shared: relaxing is left to its own in `shorter`,
# and nothing is kept of what a clock ended.
ONCE = {"relaxing": 3 + 2, "tuning": 1, "one": 2 + 1, "two": 2 + 1 + 1, "late": 2, "cold": 1}


def _path(name: str) -> list[tuple[int, int, str, str]]:
    return _legs(find_pipeline(name))


def _legs(pipeline: Pipeline) -> list[tuple[int, int, str, str]]:
    """(first, end, key, alone) of each leg, where a key is what is asked, in words."""
    plan = planned_stages(pipeline, {leg.method: load_method(leg.method) for leg in pipeline.legs})
    legs = planned_legs(plan, lambda stages: json.dumps([planned.asked() for planned in stages]))
    return [(leg.first, leg.end, leg.key, leg.alone) for leg in legs]


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
        done = cli(
            "all", *FAKES, "--out", str(out), "-j", "2", *options, COUNTS=str(counts), **environment
        )
        return Ran(out, counts, done)

    return run


@pytest.fixture(scope="module")
def whole(fakes) -> Ran:
    return fakes("whole")


def test_a_leg_ends_where_its_session_does():
    strict, descent = _path("softplus_dc+strict"), _path("softplus_dc+relu_gd")
    assert [leg[:2] for leg in strict] == [leg[:2] for leg in descent] == [(0, 3), (3, 4)]
    assert strict[0] == descent[0]
    assert strict[1][2:] != descent[1][2:]
    # Each stage has another count, and with that a session of its own.
    assert [leg[:2] for leg in _path("softplus_gd+strict")] == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert _path("softplus_gd+strict")[:3] == _path("softplus_gd+relu_gd")[:3]


def test_the_key_of_a_leg_is_of_all_that_decides_it():
    """All stages before it, and all options; alone it is what begins another pipeline."""
    mpcc = find_pipeline("mpcc")
    longer = replace(mpcc, legs=(*mpcc.legs, Leg(method="strict_lcp")))
    (mpcc,), (first, second) = _path("mpcc"), _legs(longer)
    assert first[2:] == mpcc[2:]
    assert second[2] not in {first[2], second[3]}
    (strict,) = _path("strict")
    for name in ("softplus_dc+strict", "softplus_gd+strict", "relaxed+strict"):
        last = _path(name)[-1]
        assert last[3] == strict[3] == strict[2]
        assert last[2] != strict[2]
    assert _path("lbfgs")[0][2] != _path("softplus_dc+lbfgs")[0][2]


def test_a_leg_runs_once(whole):
    assert _counted(whole.counts) == ONCE, whole.done.stderr
    found = records(whole.out)
    assert found["begin+picky"].outcome == "refused"
    owners = {
        stage.shared_from or name
        for name in ("begin+one", "begin+two", "begin")
        for stage in found[name].stages[:3]
    }
    assert len(owners) == 1
    first, second = (found[name].stages[2] for name in ("begin+one", "begin+two"))
    assert replace(first, shared_from="") == replace(second, shared_from="")
    assert [stage.shared_from for stage in found["late+two"].stages] == ["", ""]


def test_fresh_takes_nothing_over(whole, fakes):
    shutil.copytree(whole.out, whole.out.with_name("anew"))
    again = fakes("anew", "--fresh", ONLY="begin+one begin+two")
    assert _counted(again.counts) == {"relaxing": 3, "one": 1, "two": 1}, again.done.stderr
    assert untimed(again.out) == untimed(whole.out)


def test_a_session_that_leaves_its_plan_is_the_beginning_of_another(whole, lost):
    """The stage in the midst and the cold one are one and the same, whichever ran first, and what follows starts from its plan."""
    for ran, owner in ((whole, "cold"), (lost, "begin+cold+two")):
        found = records(ran.out)
        midst, cold = found["begin+cold+two"].stages[3], found["cold"].stages[0]
        assert {midst.shared_from, cold.shared_from} == {"", owner}
        assert _counted(ran.counts)["cold"] == 1
        assert midst.cost == cold.cost == 0.0  # from no plan
        assert (midst.index, cold.index) == (3, 0)
        assert midst.seconds.wall == cold.seconds.wall == cold.seconds.total
        assert [stage.cost for stage in found["begin+cold+two"].stages[4:]] == [1000.0]
        (plan,) = (ran.out / "runs" / found["begin+cold+two"].key).glob("trajectory_4.nc")
        assert read_netcdf(plan, load_scene("three_cart")).u[0, 0] == 0.0


@pytest.fixture(scope="module")
def lost(fakes) -> Ran:
    limit = "12"
    only = "soft+falls soft+one slow+one slow+two begin+cold+two cold"
    return fakes("lost", "--time-limit", limit, "-j", "1", LIMIT=limit, ONLY=only)


def test_a_leg_is_stored_before_what_comes_after_it(lost):
    """The run that made it is lost later on, and leaves it; its own record keeps it."""
    found = records(lost.out)
    assert (found["soft+falls"].outcome, found["soft+one"].outcome) == ("crashed", "solved")
    assert _counted(lost.counts)["relaxing"] == 1 + 3
    assert found["soft+one"].stages[0].shared_from == "soft+falls"
    assert [stage.outcome for stage in found["soft+falls"].stages] == ["solved", "crashed"]
    told = {"shared_from", "seconds", "survey"}  # a run that is lost tries no plan in other worlds
    kept, taken = (to_data(found[name].stages[0]) for name in ("soft+falls", "soft+one"))
    assert [name for name in kept if kept[name] != taken[name] and name not in told] == []
    assert (lost.out / "runs" / found["soft+falls"].key / "trajectory_1.nc").exists()


def test_what_used_up_the_time_of_a_cell_does_so_once(lost, tmp_path):
    found = records(lost.out)
    assert _counted(lost.counts)["slow"] == 1
    for name in ("slow+one", "slow+two"):
        assert [stage.outcome for stage in found[name].stages] == ["time_limit", "time_limit"], name
        assert "used up" in found[name].stages[1].message
    assert sorted(found[name].stages[0].shared_from for name in ("slow+one", "slow+two"))[0] == ""
    (late,) = (path.name for path in (lost.out / "legs").iterdir() if path.name.endswith("s"))
    key, scene = late.rpartition("-")[0], load_scene("three_cart")
    taken = take(lost.out / "legs", key, 12.0, 1, tmp_path / "leg_1", scene)
    assert taken[0].limit == 12.0
    for limit in (24.0, None):  # with more time it is run again; later in a path it says nothing
        assert take(lost.out / "legs", key, limit, 1, tmp_path / "leg_2", scene) is None


def test_the_time_of_a_pipeline_is_that_of_its_stages_wherever_they_ran(whole):
    for record in records(whole.out).values():
        total = 0.0
        for stage in record.stages:
            total += stage.seconds.wall
            assert stage.seconds.total == (pytest.approx(total) if stage.seconds.wall else 0.0)
        own = sum(stage.seconds.wall for stage in record.stages if not stage.shared_from)
        spent = sum(
            record.profile.get(name, 0.0)
            for name in ("build", "translate", "evaluate", "linear_algebra", "solve_rest")
        )
        assert own <= spent + 1e-3  # the profile is of what ran here, and of nothing else


def test_the_numbers_are_those_of_cells_that_share_nothing(whole, fakes):
    names = ["begin+one shorter late+one", "begin+tune+two"]
    apart = [fakes(f"apart{number}", ONLY=only) for number, only in enumerate(names)]
    rows = [row for ran in apart for row in untimed(ran.out)]
    assert len(rows) == 4 + 2 + 2 + 5
    together = untimed(whole.out)
    assert all(row in together for row in rows)


@pytest.mark.parametrize("method", ["relaxing", "two"])
def test_killed_in_between_and_resumed(whole, fakes, method):
    """In the midst of a leg, and in one that comes after it, which then starts from files.

    One cell at a time until the kill: of a second nobody knows how far it comes before it is ended
    too.
    """
    only = "begin+one begin+two begin+tune+two"
    ran = fakes(f"killed_{method}", "-j", "1", KILL=method, ONLY=only)
    assert ran.done.returncode == -9
    assert _counted(ran.counts)[method] == 1
    again = fakes(f"killed_{method}", KILL=method, ONLY=only)
    assert again.done.returncode == 0, again.done.stderr
    together = [row for row in untimed(whole.out) if row["pipeline"] in only.split()]
    assert untimed(again.out) == together
    assert _counted(again.counts)[method] == 1 + {"relaxing": 3, "two": 2}[method]
    assert {path.name for path in (again.out / "runs").iterdir()} == {
        record.key for record in records(again.out).values()
    }


@pytest.mark.parametrize(
    "damage", ["stages", "plan", "missing", "empty", "cut", "another", "number"]
)
def test_a_damaged_leg_is_put_aside(whole, tmp_path, damage):
    shutil.copytree(whole.out / "legs", tmp_path / "legs")
    scene, stored = load_scene("three_cart"), tmp_path / "legs"
    leg = next(path for path in sorted(stored.iterdir()) if (path / "trajectory_3.nc").exists())
    good = take(stored, leg.name, None, 3, tmp_path / "leg_1", scene)
    assert len(good[0].stages) == 3
    assert {path.name for path in (tmp_path / "leg_1").iterdir()} == {
        path.name for path in leg.iterdir()
    }
    content = json.loads(gzip.decompress((leg / "leg.json.gz").read_bytes()))
    if damage == "stages":
        (leg / "leg.json.gz").write_bytes(
            gzip.compress(json.dumps({**content, "stages": content["stages"][:2]}).encode())
        )
    elif damage == "plan":
        (leg / "trajectory_3.nc").write_bytes((leg / "trajectory_3.nc").read_bytes()[:-1] + b"x")
    elif damage == "missing":
        (leg / "trajectory_2.nc").unlink()
    elif damage == "empty":
        (leg / "leg.json.gz").write_bytes(b"")
    elif damage == "cut":
        (leg / "leg.json.gz").write_bytes((leg / "leg.json.gz").read_bytes()[:-40])
    elif damage == "number":
        (leg / "leg.json.gz").write_bytes(
            gzip.compress(json.dumps({**content, "stages": content["stages"][::-1]}).encode())
        )
    else:
        (leg / "leg.json.gz").write_bytes(
            gzip.compress(json.dumps({**content, "key": "0" * 64}).encode())
        )
    assert take(stored, leg.name, None, 3, tmp_path / "leg_2", scene) is None
    assert not leg.exists()  # no run meets it again
    assert not (tmp_path / "leg_2").exists()


def test_legs_of_a_run_are_read_up_to_the_first_that_is_not_whole(whole, tmp_path):
    keys = [path.name for path in sorted((whole.out / "legs").iterdir())][:3]
    legs = tuple(PlannedLeg(0, 1, key, key) for key in keys)
    for number, key in enumerate(keys, 1):
        shutil.copytree(whole.out / "legs" / key, place(tmp_path, number))
    assert [leg.key for leg in legs_in(tmp_path, legs)] == keys
    (place(tmp_path, 2) / "leg.json.gz").write_bytes(b"[]")
    assert [leg.key for leg in legs_in(tmp_path, legs)] == keys[:1]


def test_plans_of_legs_lie_in_the_run(whole):
    scene = load_scene("three_cart")
    for name in ("begin+one", "begin+two", "begin"):
        record = records(whole.out)[name]
        folder = whole.out / "runs" / record.key
        plans = [f"trajectory_{number}.nc" for number in range(1, len(record.stages))] + [
            "trajectory.nc"
        ]
        assert sorted(path.name for path in folder.glob("trajectory*.nc")) == sorted(plans)
        assert [read_netcdf(folder / plan, scene).u[0, 0] for plan in plans] == list(
            range(len(plans))
        )
        assert not [path for path in folder.iterdir() if path.is_dir()]
