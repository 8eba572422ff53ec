"""Campaigns that are killed, that share a folder, or whose cells come in another order, on Dask, or where nothing is shared: the same numbers, to the last bit, nothing lost, nothing left behind."""

import importlib.util
import random
import signal
import time
from pathlib import Path

import pytest
from killed_campaigns import (
    FAKES_FOLDER,
    Kill,
    finished,
    kill_and_resume,
    processes,
    start,
    unfinished,
    untimed,
)
from standing_cluster import come

from models.catalog import load_scene
from models.results.run import RunRecord
from models.results.stored import from_json
from models.trajectory_netcdf import read_netcdf
from touchstone_annexes import is_present
from validate.campaign import campaign
from validate.campaign.campaign import run_campaign
from validate.campaign.runs import CampaignSettings
from validate.cli.narrator import PlainNarrator

pytestmark = [pytest.mark.slow, pytest.mark.process]

# Most of them share their beginning; two of them crash, and are run again whenever the campaign is.
CELLS = "soft or only_good"
_KILLS = [Kill(), Kill(victim="supervisor")]


@pytest.fixture(scope="module")
def cache(cli_environment) -> Path:
    return Path(cli_environment["TOUCHSTONE_CACHE"])


@pytest.fixture(scope="module")
def temporary(tmp_path_factory):
    """The folder for temporary files of every campaign here."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(folder))
        yield folder


@pytest.fixture(scope="module")
def killed(cache, temporary, tmp_path_factory):
    """The folder of a campaign that nothing happened to, and what was seen of one that was killed."""
    folder = tmp_path_factory.mktemp("reliable")
    return folder / "whole", kill_and_resume(folder, cache, _KILLS, 1, "-j", "2", cells=CELLS)


@pytest.mark.whole
def test_a_killed_campaign_loses_nothing_and_leaves_nothing(killed, temporary):
    _, seen = killed
    assert seen.faults == []
    assert seen.kills == _KILLS
    assert list(temporary.iterdir()) == []


def test_two_campaigns_in_the_folder_of_a_killed_one_do_not_disturb_each_other(
    cache, killed, temporary, tmp_path
):
    """They start while what the killed one was running has perhaps not ended yet."""
    out, (whole, _) = tmp_path / "out", killed
    first = start(out, cache, f"{CELLS} or only_family", "-j", "2")
    for _ in range(1200):
        if finished(out):
            break
        time.sleep(0.1)
    kept = finished(out)
    first.send_signal(signal.SIGKILL)
    first.wait()
    both = [start(out, cache, CELLS, "-j", "1") for _ in range(2)]
    assert [process.wait() for process in both] == [1, 1]
    assert kept
    assert untimed(out) == untimed(whole)
    assert set(finished(out)) == set(finished(whole))
    assert unfinished(out) == []
    assert processes(out) == []
    assert list(temporary.iterdir()) == []


SCENE = "wall_pendulum"
CHAINS = "real_chains:PLUGIN"
CAMPAIGN = ("--scene", SCENE, "--plugin", CHAINS, "--no-worlds")


@pytest.fixture(scope="module")
def whole(cli, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    done = cli("all", *CAMPAIGN, "-j", "1", "--out", str(out))
    assert done.returncode == 0, done.stderr
    return out


def _plans(out: Path) -> dict[tuple[str, str], bytes]:
    """The bits of all plans of a campaign, by cell and file."""
    scene = load_scene(SCENE)
    found = {}
    for file in sorted((out / "runs").glob("*/trajectory*.nc")):
        plan = read_netcdf(file, scene)
        found[file.parent.name, file.name] = b"".join(
            array.tobytes() for array in (plan.q, plan.v, plan.u, plan.lam)
        )
    return found


def _same(out: Path, whole: Path) -> None:
    rows, expected = untimed(out), untimed(whole)
    assert sorted(map(str, rows)) == sorted(map(str, expected))
    assert set(finished(out)) == set(finished(whole))
    assert unfinished(out) == []
    plans = _plans(whole)
    assert len(plans) > 10
    assert _plans(out) == plans


def test_something_is_shared(whole):
    records = [from_json(RunRecord, content) for content in finished(whole).values()]
    assert (
        sum(any(stage.shared_from for stage in record.stages) for record in records) == 2
    )  # of three chains that begin alike, all but the first


def test_in_another_order(whole, tmp_path, monkeypatch):
    """Whichever cell comes first runs what several begin with."""
    chosen = campaign.select

    def shuffled(settings: CampaignSettings):
        entries, left_out = chosen(settings)
        random.Random(1).shuffle(entries)
        return entries, left_out

    monkeypatch.setattr(campaign, "select", shuffled)
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    run_campaign(
        CampaignSettings(out=tmp_path, scenes=(SCENE,), plugin=CHAINS, worlds=False, jobs=2),
        PlainNarrator(),
    )
    _same(tmp_path, whole)


def test_resumed_after_a_kill(whole, cli, start_cli, tmp_path):
    process = start_cli("all", *CAMPAIGN, "-j", "2", "--out", str(tmp_path))
    come(lambda: len(finished(tmp_path)) >= 1 or process.poll() is not None)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = finished(tmp_path)
    assert 1 <= len(kept) < len(finished(whole))
    done = cli("all", *CAMPAIGN, "-j", "2", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert kept.items() <= finished(tmp_path).items()
    _same(tmp_path, whole)


def test_where_nothing_is_shared(whole, cli, tmp_path):
    """A cell in a folder of its own has every stage to itself, this one took over what another chain began with."""
    records = [from_json(RunRecord, content) for content in finished(whole).values()]
    pipeline = next(record.pipeline for record in records if record.stages[0].shared_from)
    done = cli("all", *CAMPAIGN, "-k", f"={pipeline}", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert [row for row in untimed(whole) if row["pipeline"] == pipeline] == untimed(tmp_path)
    assert _plans(tmp_path).items() <= _plans(whole).items()


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None or not is_present("validate.campaign.dask"),
    reason="distributed (the extra `dask`) or the annex is not installed",
)
def test_on_dask(whole, cli, tmp_path):
    done = cli("all", *CAMPAIGN, "-j", "2", "--engine", "dask", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    _same(tmp_path, whole)
