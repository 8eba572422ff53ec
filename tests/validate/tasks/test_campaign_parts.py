"""A pipeline in parts: one cell a part, one row of results.

Certificates from the campaign's own judge. Plans that hold are tried in perturbed worlds: once for
a plan, stored by its content, left out where that is asked for.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from formulations.method import Leg, Pipeline
from formulations.pipelines import STARTS, find_pipeline, parts_of, stage_plan
from models.catalog import load_scene, scene_names
from models.codegen.kernel import load_kernel
from models.trajectory import Trajectory, uniform_grid
from reports.records.record import RunRecord
from validate.plan.runs import CampaignSettings, PlannedTask, scenes_of, select, with_stored
from validate.store.provenance import content_key, gather
from validate.store.store import Store
from validate.tasks.path import run_path
from validate.tasks.profile import Profile
from validate.tasks.task import CheckTask, RunTask

SCENE = load_scene("three_cart").with_task(steps=20)


def plan() -> Trajectory:
    """Nothing pushed, nothing moved."""
    task = SCENE.task
    rollout = load_kernel(SCENE).rollout(np.array(task.start), np.zeros((20, 2)), task.step)
    return Trajectory(
        t=uniform_grid(task.step, 20),
        q=rollout.q,
        v=rollout.v,
        u=np.zeros((20, 2)),
        lam=rollout.lam,
    )


def test_every_start_is_in_one_cell() -> None:
    cells = parts_of(find_pipeline("mpcc_multistart"))
    numbers = []
    for cell in cells:
        (_, _, options) = stage_plan(cell)[0]
        numbers += range(
            int(str(options["first_start"])),
            int(str(options["first_start"])) + int(str(options["starts"])),
        )
    assert numbers == list(range(STARTS)) == list(range(20))
    assert [cell.part for cell in cells] == [
        (place, len(cells)) for place in range(1, len(cells) + 1)
    ]
    assert {cell.name for cell in cells} == {"mpcc_multistart"}


def test_a_pipeline_without_parts_is_its_own_cell() -> None:
    pipeline = find_pipeline("strict")
    assert parts_of(pipeline) == (pipeline,)


def test_options_of_a_part_lie_over_those_of_the_leg() -> None:
    whole = Pipeline(
        name="p",
        title="",
        legs=(Leg(method="m", options={"a": 1, "b": 1}),),
        parts=({"b": 2}, {"b": 3}),
    )
    assert [dict(cell.legs[0].options) for cell in parts_of(whole)] == [
        {"a": 1, "b": 2},
        {"a": 1, "b": 3},
    ]


def test_a_campaign_runs_the_parts_as_cells_of_their_own(tmp_path) -> None:
    entries, _ = select(
        CampaignSettings(out=tmp_path, scenes=("three_cart",), expression="multistart")
    )
    assert len(entries) == 4
    assert len({entry.task.key for entry in entries}) == 4
    assert entries[1].task.title == "three_cart x mpcc_multistart (2 of 4)"


@pytest.mark.slow
def test_the_table_of_a_rebuilt_report_is_that_of_its_campaign(cli, tmp_path) -> None:
    done = cli("all", "--scene", "bouncing_mass", "-k", "mpcc_multistart", "--out", str(tmp_path))
    assert "0 stored, 4 to run" in done.stderr, done
    table = (tmp_path / "results.csv").read_bytes()
    assert table.count(b"bouncing_mass,mpcc_multistart") == 1
    assert cli("report", str(tmp_path)).returncode == 0
    assert (tmp_path / "results.csv").read_bytes() == table


def test_a_quick_campaign_says_once_what_it_leaves_out_of_every_scene(tmp_path) -> None:
    entries, left_out = select(
        CampaignSettings(
            out=tmp_path,
            scenes=("three_cart", "bouncing_mass"),
            quick=True,
            expression="strict or free_motion",
        )
    )
    chosen = [(entry.task.scene_name, entry.task.pipeline.name) for entry in entries]
    quick = "softplus_dc+strict"
    assert chosen == [
        ("three_cart", quick),
        ("bouncing_mass", quick),
        ("bouncing_mass", "free_motion"),
    ]
    assert left_out == tuple(
        f"every scene x {name}" for name in ("strict", "relaxed+strict", "softplus_gd+strict")
    )
    _, of_one = select(
        CampaignSettings(
            out=tmp_path, scenes=("three_cart",), quick=True, expression="softplus and strict"
        )
    )
    assert of_one == ("three_cart x softplus_gd+strict",)


@pytest.mark.slow
def test_a_quick_campaign_leaves_out_the_long_scenes_unless_they_are_named(tmp_path) -> None:
    entries, left_out = select(CampaignSettings(out=tmp_path, quick=True))
    scenes = {name: load_scene(name) for name in scene_names()}
    long = {name for name, scene in scenes.items() if not scene.quick}
    assert long
    assert set(scenes_of(entries)) == set(scenes) - long
    assert {f"{name} x every pipeline" for name in long} <= set(left_out)
    assert not {entry.task.scene for entry in entries if isinstance(entry.task, CheckTask)} & long
    named, _ = select(CampaignSettings(out=tmp_path, quick=True, scenes=(min(long),)))
    assert set(scenes_of(named)) == {min(long)}
    every, _ = select(CampaignSettings(out=tmp_path))
    assert set(scenes_of(every)) == set(scenes)


def planned(out: Path, *, robust: bool = True) -> PlannedTask:
    (entry,), _ = select(
        CampaignSettings(out=out, scenes=("wall_pendulum",),
                         expression="=mpcc and not multistart and not best_exact",
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
    )  # type: ignore[union-attr]


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
