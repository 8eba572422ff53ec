"""A pipeline in parts: one cell a part, one row of results; certificates from the campaign's own judge; starts.csv and front.csv."""

import numpy as np
import pytest

from formulations.method import Leg, Pipeline
from formulations.pipelines import STARTS, find_pipeline, parts_of, stage_plan
from models.catalog import load_scene, scene_names
from models.codegen.kernel import load_kernel
from models.trajectory import Trajectory, uniform_grid
from validate.execution.campaign import CampaignSettings, select
from validate.plan.runs import PlannedCheck, PlannedRun

SCENE = load_scene("three_cart").with_task(steps=20)


def plan() -> Trajectory:
    """Nothing pushed, nothing moved."""
    task = SCENE.task
    rollout = load_kernel(SCENE).rollout(np.array(task.start), np.zeros((20, 2)), task.step)
    return Trajectory(t=uniform_grid(task.step, 20), q=rollout.q, v=rollout.v, u=np.zeros((20, 2)), lam=rollout.lam)


def test_every_start_is_in_one_cell() -> None:
    cells = parts_of(find_pipeline("mpcc_multistart"))
    numbers = []
    for cell in cells:
        (_, _, options) = stage_plan(cell)[0]
        numbers += range(int(str(options["first_start"])), int(str(options["first_start"])) + int(str(options["starts"])))
    assert numbers == list(range(STARTS)) == list(range(20))
    assert [cell.part for cell in cells] == [(place, len(cells)) for place in range(1, len(cells) + 1)]
    assert {cell.name for cell in cells} == {"mpcc_multistart"}


def test_a_pipeline_without_parts_is_its_own_cell() -> None:
    pipeline = find_pipeline("strict")
    assert parts_of(pipeline) == (pipeline,)


def test_options_of_a_part_lie_over_those_of_the_leg() -> None:
    whole = Pipeline(name="p", title="", legs=(Leg(method="m", options={"a": 1, "b": 1}),), parts=({"b": 2}, {"b": 3}))
    assert [dict(cell.legs[0].options) for cell in parts_of(whole)] == [{"a": 1, "b": 2}, {"a": 1, "b": 3}]


def test_a_campaign_runs_the_parts_as_cells_of_their_own(tmp_path) -> None:
    entries, _ = select(CampaignSettings(out=tmp_path, scenes=("three_cart",), expression="multistart"))
    assert len(entries) == 4
    assert len({entry.task.key for entry in entries}) == 4
    assert entries[1].task.title == "three_cart x mpcc_multistart (2 of 4)"


@pytest.mark.slow
def test_the_table_of_a_rebuilt_report_is_that_of_its_campaign(cli, tmp_path) -> None:
    done = cli("all", "--scene", "bouncing_mass", "-k", "mpcc_multistart", "--out", str(tmp_path))
    assert "[4/4]" in done.stdout + done.stderr, done
    table = (tmp_path / "results.csv").read_bytes()
    assert table.count(b"bouncing_mass,mpcc_multistart") == 1
    assert cli("report", str(tmp_path)).returncode == 0
    assert (tmp_path / "results.csv").read_bytes() == table


def test_a_quick_campaign_says_once_what_it_leaves_out_of_every_scene(tmp_path) -> None:
    entries, left_out = select(
        CampaignSettings(out=tmp_path, scenes=("three_cart", "bouncing_mass"), quick=True, expression="strict or free_motion")
    )
    chosen = [(entry.scene.name, entry.task.pipeline.name) for entry in entries]
    quick = "softplus_dc+strict"
    assert chosen == [("three_cart", quick), ("bouncing_mass", quick), ("bouncing_mass", "free_motion")]
    assert left_out == tuple(f"every scene x {name}" for name in ("strict", "relaxed+strict", "softplus_gd+strict"))
    _, of_one = select(CampaignSettings(out=tmp_path, scenes=("three_cart",), quick=True, expression="softplus and strict"))
    assert of_one == ("three_cart x softplus_gd+strict",)


@pytest.mark.slow
def test_a_quick_campaign_leaves_out_the_long_scenes_unless_they_are_named(tmp_path) -> None:
    entries, left_out = select(CampaignSettings(out=tmp_path, quick=True))
    scenes = {name: load_scene(name) for name in scene_names()}
    long = {name for name, scene in scenes.items() if not scene.quick}
    assert long
    assert {entry.scene.name for entry in entries if isinstance(entry, PlannedRun)} == set(scenes) - long
    assert {f"{name} x every pipeline" for name in long} <= set(left_out)
    assert not {entry.task.scene for entry in entries if isinstance(entry, PlannedCheck)} & long
    named, _ = select(CampaignSettings(out=tmp_path, quick=True, scenes=(min(long),)))
    assert {entry.scene.name for entry in named if isinstance(entry, PlannedRun)} == {min(long)}
    every, _ = select(CampaignSettings(out=tmp_path))
    assert {entry.scene.name for entry in every if isinstance(entry, PlannedRun)} == set(scenes)
