"""What holds of every engine: the same rows, the same endings, nothing left behind.

`dask` is a LocalCluster, `standing` a cluster by its scheduler file.
"""

import importlib.util
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any, cast

import pytest
from killed_campaigns import finished, processes, records, unfinished, untimed
from standing_cluster import come, standing_cluster
from wording import saying, unsaid

from models.errors import MachineError
from validate.campaign.engine import EngineError, check_engine

pytestmark = pytest.mark.process

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
# Chains that share their beginning, cells that end well, give up, raise and die.
CELLS = (*FAKES, "-k", "soft or only_good or only_segfault or only_infeasible", "-j", "2")
NEEDS_DASK = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="distributed is not installed (the extra `dask`)",
)


@pytest.fixture(scope="module")
def standing(cli_environment, tmp_path_factory):
    """A scheduler and two worker processes; the engine's name for them."""
    with standing_cluster(tmp_path_factory.mktemp("cluster"), cli_environment, workers=2) as (
        file,
        _,
    ):
        yield f"dask:{file}"


@pytest.fixture
def engine(request: pytest.FixtureRequest) -> str:
    return request.getfixturevalue("standing") if request.param == "standing" else request.param


@pytest.fixture(scope="module")
def expected(cli, tmp_path_factory) -> Path:
    """The folder of a campaign by the local engine."""
    out = tmp_path_factory.mktemp("expected") / "out"
    done = cli("all", *CELLS, "--out", str(out))
    assert done.returncode == 1, done.stderr
    return out


@pytest.mark.slow
@pytest.mark.parametrize("engine", [pytest.param("standing", marks=NEEDS_DASK)], indirect=True)
def test_the_rows_are_those_of_the_local_engine(cli, engine, expected, tmp_path):
    done = cli("all", *CELLS, "--out", str(tmp_path / "out"), "--engine", engine)
    assert done.returncode == 1, done.stderr
    assert untimed(tmp_path / "out") == untimed(expected)
    assert set(finished(tmp_path / "out")) == set(finished(expected))
    assert unfinished(tmp_path / "out") == []
    theirs, ours = records(expected), records(tmp_path / "out")
    assert {name: record.message for name, record in ours.items()} == {
        name: record.message for name, record in theirs.items()
    }
    assert ours["only_good"].provenance.cpu == theirs["only_good"].provenance.cpu
    shared = [
        stage.shared_from
        for record in ours.values()
        for stage in record.stages
        if stage.shared_from
    ]
    assert (
        len(shared)
        == len(
            [stage for record in theirs.values() for stage in record.stages if stage.shared_from]
        )
        > 0
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "engine", [pytest.param(name, marks=NEEDS_DASK) for name in ("dask", "standing")], indirect=True
)
def test_ctrl_c_stops_what_runs_and_says_how_to_go_on(cli, start_cli, engine, tmp_path):
    """What the local engine does then, test_campaign_worker.py shows."""
    arguments = (
        "all",
        *FAKES,
        "-k",
        "only_good or only_family",
        "--engine",
        engine,
        "--out",
        str(tmp_path),
        "-j",
        "1",
    )
    process = start_cli(*arguments)
    come(
        lambda: len(processes(tmp_path)) >= 4 and len(finished(tmp_path)) == 1
    )  # the cell, its supervisor and both its children
    os.killpg(
        process.pid, signal.SIGINT
    )  # as a terminal does: everything in the foreground hears it
    _, told = process.communicate()
    assert process.returncode == 130, told
    assert "interrupted: 1 of 2 runs are stored" in told
    assert (
        f"resume with: {sys.executable} -m validate {' '.join(arguments).replace('only_good or only_family', repr('only_good or only_family'))}"
        in told
    )
    assert "Traceback" not in told
    assert processes(tmp_path) == []
    assert unfinished(tmp_path) == []
    assert [row["pipeline"] for row in untimed(tmp_path)] == ["only_good"]
    if engine.startswith("dask:"):  # the cluster goes on, and runs what comes next
        kept = finished(tmp_path)
        resumed = cli(
            "all",
            *FAKES,
            "-k",
            "only_good or only_infeasible",
            "--engine",
            engine,
            "--out",
            str(tmp_path),
        )
        assert "1 stored, 1 to run" in resumed.stderr
        assert resumed.returncode == 0, resumed.stderr
        assert kept.items() < finished(tmp_path).items()


@pytest.mark.slow
@pytest.mark.parametrize(
    "engine", ["local", pytest.param("standing", marks=NEEDS_DASK)], indirect=True
)
def test_a_crash_is_tried_again_and_ends_the_campaign_at_once_where_wanted(cli, engine, tmp_path):
    done = cli(
        "all",
        *FAKES,
        "-k",
        "only_segfault or only_hang",
        "-j",
        "2",
        "-x",
        "--retry",
        "1",
        "--engine",
        engine,
        "--out",
        str(tmp_path),
    )
    assert done.returncode == 1
    assert done.stderr.count("only_segfault crashed and will be tried again") == 1
    assert not unsaid(done.stderr, "first failure (-x)", "1 of 2 runs are stored in ")
    assert {name: record.outcome for name, record in records(tmp_path).items()} == {
        "only_segfault": "crashed"
    }
    assert processes(tmp_path) == []
    assert unfinished(tmp_path) == []


@NEEDS_DASK
def test_a_worker_that_sees_another_folder_or_has_other_sources_says_so(tmp_path, monkeypatch):
    from validate.campaign.dask import engine as dask_cell
    from validate.store.provenance import fingerprint

    monkeypatch.setattr(dask_cell, "_wanted", lambda: lambda: True)
    monkeypatch.setattr(dask_cell, "_PATIENCE", 0.0)
    asked: Any = {
        "provenance": None,
        "folder": tmp_path,
        "mark": ".partial-campaign-x",
        "token": "",
        "tasks": 1,
    }
    with pytest.raises(
        MachineError, match=f"folder {tmp_path} is not seen here.*the Dask worker on"
    ):
        dask_cell.run_on_worker(cast("Any", None), "", **asked, sources=fingerprint())
    (tmp_path / "runs" / asked["mark"]).mkdir(parents=True)
    with pytest.raises(
        MachineError, match=r"sources, libraries or compiler.*not those of the campaign"
    ):
        dask_cell.run_on_worker(cast("Any", None), "", **asked, sources="another")


@pytest.mark.parametrize(("name", "words"), [
    ("slurm", "no such engine; … local, dask, dask:ADDRESS and dask:FILE.json"),
    ("dask:", "there is no such engine"),
    ("local:2", "there is no such engine"),
    pytest.param("dask:no.json", "scheduler file … No such file", marks=NEEDS_DASK),
    pytest.param("dask:empty.json", "it is no JSON", marks=NEEDS_DASK),
    pytest.param("dask:other.json", "it has no `address`", marks=NEEDS_DASK),
])  # fmt: skip
def test_a_wrong_engine_is_said_before_anything_runs(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    Path("empty.json").write_text("")
    Path("other.json").write_text("[]")
    with pytest.raises(EngineError, match=saying(words)):
        check_engine(name)


@pytest.mark.slow
def test_without_dask_it_is_said_how_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MachineError, match=re.escape("pip install distributed")):
        check_engine("dask")
