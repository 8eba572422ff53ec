"""Plans that hold are tried in perturbed worlds: once for a plan, stored by its content, left out where that is asked for."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from reports.records.record import RunRecord
from validate.plan.runs import CampaignSettings, PlannedTask, select, with_stored
from validate.store.provenance import content_key, gather
from validate.store.store import Store
from validate.tasks.path import run_path
from validate.tasks.profile import Profile
from validate.tasks.task import RunTask


def planned(out: Path, *, robust: bool = True) -> PlannedTask:
    (entry,), _ = select(
        CampaignSettings(out=out, scenes=("wall_pendulum",),
                         expression="=mpcc and not best_exact",
                         robust=robust),
    )  # fmt: skip
    assert entry.loaded is not None
    return entry


def ran(store: Store, task: RunTask, name: str) -> RunRecord:
    folder = store.runs / name
    folder.mkdir(parents=True)
    return run_path(task, gather("a test"), folder, Profile(time.monotonic()))


@pytest.mark.slow
def test_a_plan_is_tried_once_and_stored_by_its_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fakes"))
    store, task = Store(tmp_path), planned(tmp_path).task
    found = ran(store, task, "first").stages[-1].survey
    assert found is not None
    assert found.alone is not None
    assert 0.6 < found.alone.share < 0.9
    assert (found.message, found.weakest, found.by) == ("", "l", "replay_cost")
    (stored,) = store.surveys.iterdir()
    assert json.loads(stored.read_text())["weakest"] == "l"
    stored.write_text(stored.read_text().replace('"l"', '"as stored"'))
    again = ran(store, task, "second").stages[-1].survey
    assert again is not None
    assert again.weakest == "as stored"
    stored.write_text(stored.read_text()[:40])
    assert ran(store, task, "third").stages[-1].survey == found, "what is damaged is found out anew"
    assert ran(store, replace(task, robust=False), "fourth").stages[-1].survey is None
    assert (
        ran(store, replace(task, plugin="real_chains:STUMBLING"), "fifth").stages[-1].survey.message
        == "ZeroDivisionError: a stumble"
    )


def test_a_run_without_is_another_run_of_the_same_legs(tmp_path: Path):
    tried, untried = planned(tmp_path).task, planned(tmp_path, robust=False).task
    assert tried.key != untried.key
    assert tried.legs == untried.legs
    assert (tried.robust, untried.robust) == (True, False)
    scene = planned(tmp_path).loaded.scene
    assert content_key(scene, [], ()) != content_key(scene, [], (), robust=True), (
        "what tries plans decides nothing of how they are found"
    )


@pytest.mark.slow
def test_a_run_that_ended_before_its_plan_was_tried_is_run_again_where_there_is_more_time(
    tmp_path: Path,
):
    store, entry = Store(tmp_path), planned(tmp_path)
    store.prepare()
    record = ran(store, replace(entry.task, robust=False), entry.task.key)
    folder = store.runs / entry.task.key
    (folder / "record.json").write_text(
        record.model_copy(update={"key": entry.task.key}).model_dump_json()
    )
    (folder / "files.json").write_text(
        json.dumps({path.name: path.stat().st_size for path in folder.glob("*.nc")})
    )
    for limit, again in ((240.0, False), (100.0, True)):
        (folder / "task.json").write_text(json.dumps({"task": {"time_limit": limit}}))
        (found,) = with_stored([entry], store, CampaignSettings(out=tmp_path))
        assert (found.stored is None) is again, found.why
