"""A campaign tries the cheapest plan of each scene in perturbed worlds, or every plan, or none."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from models.results.robustness import Survey
from models.results.run import RunRecord
from models.results.stored import to_json
from tests.reports import record_factory as factory
from validate.campaign.runs import CampaignSettings, PlannedTask, select, worlds_tasks
from validate.store.provenance import gather, survey_sources
from validate.store.store import Store
from validate.tasks.path import run_path, survey_run
from validate.tasks.profile import Profile
from validate.tasks.task import RunTask
from validate.tasks.worker import Worker


def planned(out: Path) -> PlannedTask:
    (entry,), _ = select(
        CampaignSettings(out=out, scenes=("wall_pendulum",), expression="=mpcc and not best_exact")
    )
    return entry


def tried(store: Store, task: RunTask) -> Survey:
    folder = store.runs / ".unfinished"
    folder.mkdir(exist_ok=True)
    record = survey_run(task, folder, Profile(time.monotonic()))
    found = record.stages[-1].survey
    assert found is not None
    return found


@pytest.mark.slow
def test_a_plan_is_tried_once_and_stored_by_its_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "fakes"))
    store, task = Store(tmp_path), planned(tmp_path).task
    assert isinstance(task, RunTask)
    folder = store.runs / task.key
    folder.mkdir(parents=True)
    run = run_path(task, gather("a test"), folder, Profile(time.monotonic()))
    assert run.stages[-1].survey is None
    (folder / "record.json").write_text(to_json(run))
    last = replace(task, worlds=(len(run.stages) - 1,))
    found = tried(store, last)
    assert found.alone is not None
    assert 0.6 < found.alone.share < 0.9
    assert (found.message, found.weakest, found.by) == ("", "l", "replay_cost")
    (stored,) = store.surveys.iterdir()
    assert json.loads(stored.read_text())["weakest"] == "l"
    stored.write_text(stored.read_text().replace('"l"', '"as stored"'))
    assert tried(store, last).weakest == "as stored"
    stored.write_text(stored.read_text()[:40])
    assert tried(store, last) == found, "a damaged file is replaced"
    stumbled = tried(store, replace(last, plugin="real_chains:STUMBLING"))
    assert stumbled.message == "ZeroDivisionError: a stumble"


@pytest.mark.slow
def test_a_try_amends_the_stored_run_and_one_that_is_ended_leaves_it(tmp_path: Path):
    store, provenance = Store(tmp_path), gather("a test")
    store.prepare()
    task = planned(tmp_path).task
    assert isinstance(task, RunTask)
    run = Worker(task, provenance, store).run(lambda: True)
    assert isinstance(run, RunRecord)
    files = sorted(path.name for path in (store.runs / run.key).iterdir())
    last = replace(task, worlds=(len(run.stages) - 1,))
    ended = Worker(replace(last, time_limit=1e-3), provenance, store).run(lambda: True)
    assert isinstance(ended, RunRecord)
    assert "ended at its time limit" in ended.stages[-1].survey.message
    assert ended.stages[-1].survey.sources == "", "the next campaign tries it again"
    assert (ended.outcome, ended.verdict, ended.cost) == (run.outcome, run.verdict, run.cost)
    found = Worker(last, provenance, store).run(lambda: True)
    assert found == store.read(run.key)
    assert isinstance(found, RunRecord)
    assert found.stages[-1].survey.alone is not None
    assert found.cpu_seconds > run.cpu_seconds
    assert sorted(path.name for path in (store.runs / run.key).iterdir()) == files
    assert [path.name for path in store.runs.iterdir()] == [run.key], "no unfinished folder is left"


def test_the_cheapest_plan_of_a_scene_is_tried_or_all_or_none(tmp_path: Path):
    entries, _ = select(
        CampaignSettings(out=tmp_path, scenes=("wall_pendulum",), expression="strict")
    )
    cheap, expensive, violating = entries[:3]
    records = {
        cheap.task.key: a_run(cheap, 2.0, "holds"),
        expensive.task.key: a_run(expensive, 3.0, "holds with feedback"),
        violating.task.key: a_run(violating, 1.0, "violates"),
    }

    def keys(worlds: bool | None) -> list[str]:
        return [task.key for task in worlds_tasks(entries, records, worlds)]

    assert keys(None) == [cheap.task.key]
    assert keys(True) == [cheap.task.key, expensive.task.key]
    assert keys(False) == []
    (task,) = worlds_tasks(entries, records, None)
    assert task.worlds == (0,)
    stored = {"another": replace(a_run(cheap, 1.0, "holds"), key="another")}
    both = {**records, **stored}
    assert worlds_tasks(entries, both, None) == [], "the cheapest is not of this part"
    records[cheap.task.key] = a_run(cheap, 2.0, "holds", Survey(sources=survey_sources()))
    assert keys(None) == [], "it was tried"
    records[cheap.task.key] = a_run(cheap, 2.0, "holds", Survey(sources="other code"))
    assert keys(None) == [cheap.task.key]


def test_of_two_plans_of_one_cost_the_first_of_the_campaign_is_tried(tmp_path: Path):
    entries, _ = select(
        CampaignSettings(out=tmp_path, scenes=("wall_pendulum",), expression="strict")
    )
    first, second = (entry.task.key for entry in entries[:2])
    records = {entry.task.key: a_run(entry, 2.0, "holds") for entry in entries[:2]}
    assert [task.key for task in worlds_tasks(entries, records, None)] == [first]
    part = [entry for entry in entries if entry.task.key == second]
    assert worlds_tasks(part, records, None) == [], "a part of the campaign does not change that"


def a_run(entry: PlannedTask, cost: float, verdict: str, survey: Survey | None = None) -> RunRecord:
    run = factory.runs()[0]
    last = replace(run.stages[-1], index=0, cost=cost, verdict=verdict, survey=survey)
    return replace(run, key=entry.task.key, verdict=verdict, stages=(last,))
