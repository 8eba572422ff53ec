"""A pipeline in parts: one cell a part, one row of results; certificates from the campaign's own judge; starts.csv and front.csv."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from formulations.method import Leg, Pipeline
from formulations.mpec import certify_plan
from formulations.pipelines import STARTS, cells_of, find_pipeline, pipeline_from_json, pipeline_to_json, stage_plan
from formulations.solution import Attempt, FrontPoint, Outcome, Solution
from models.catalog import load_scene, scene_names
from models.codegen.kernel import load_kernel
from models.trajectory import Trajectory, uniform_grid
from validate.execution.campaign import CampaignSettings, select
from validate.plan.runs import PlannedCheck, PlannedRun
from validate.store.provenance import gather
from validate.store.results import FRONT, write_sweeps
from validate.store.results import STARTS as STARTS_FILE
from validate.tasks.records import certificate_record, front_records, start_records

SCENE = load_scene("three_cart").with_task(steps=20)


def plan() -> Trajectory:
    """Nothing pushed, nothing moved."""
    task = SCENE.task
    rollout = load_kernel(SCENE).rollout(np.array(task.start), np.zeros((20, 2)), task.step)
    return Trajectory(t=uniform_grid(task.step, 20), q=rollout.q, v=rollout.v, u=np.zeros((20, 2)), lam=rollout.lam)


def test_every_start_is_in_one_cell() -> None:
    cells = cells_of(find_pipeline("mpcc_multistart"))
    numbers = []
    for cell in cells:
        (_, _, options) = stage_plan(cell)[0]
        numbers += range(int(str(options["first_start"])), int(str(options["first_start"])) + int(str(options["starts"])))
    assert numbers == list(range(STARTS)) == list(range(20))
    assert [cell.part for cell in cells] == [(place, len(cells)) for place in range(1, len(cells) + 1)]
    assert {cell.name for cell in cells} == {"mpcc_multistart"}


def test_a_pipeline_without_parts_is_its_own_cell() -> None:
    pipeline = find_pipeline("strict")
    assert cells_of(pipeline) == (pipeline,)


def test_options_of_a_part_lie_over_those_of_the_leg() -> None:
    whole = Pipeline(name="p", title="", legs=(Leg(method="m", options={"a": 1, "b": 1}),), parts=({"b": 2}, {"b": 3}))
    assert [dict(cell.legs[0].options) for cell in cells_of(whole)] == [{"a": 1, "b": 2}, {"a": 1, "b": 3}]
    for cell in cells_of(whole):
        again = pipeline_from_json(pipeline_to_json(cell))
        assert again.part == cell.part
        assert stage_plan(again) == stage_plan(cell)


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


def test_a_certificate_becomes_a_record() -> None:
    record = certificate_record(certify_plan(SCENE, plan()))
    assert record is not None
    assert not record.holds
    assert record.primal == pytest.approx(0.5)
    assert record.worst.startswith("constraint_goal_position")
    assert record.pairs == 40
    assert certificate_record(None) is None


def solution() -> Solution:
    moved = replace(plan(), lam=np.where(np.arange(20)[:, None] % 10 < 3, 1.0, 0.0) * [1.0, 0.0])
    inner = Solution(method="mpcc", outcome=Outcome.SOLVED, trajectory=moved, cost=4.0, residuals={"discrete_terminal_error": 0.01})
    nothing = Solution(method="mpcc", outcome=Outcome.INFEASIBLE)
    return replace(
        inner,
        starts=(
            Attempt(number=0, start="here", outcome=Outcome.SOLVED, cost=4.0, windows=(("left", 0, 2),), seconds=0.5),
            Attempt(number=1, start="there", outcome=Outcome.STALLED),
        ),
        front=(FrontPoint(tolerance=0.0, solution=nothing), FrontPoint(tolerance=0.01, solution=inner)),
    )


def test_starts_and_front_become_records_and_files(tmp_path, factory_run) -> None:
    starts, front = start_records(solution()), front_records(SCENE, solution())
    assert [(item.number, item.outcome, item.cost) for item in starts] == [(0, "solved", 4.0), (1, "stalled", None)]
    assert front[1].windows == (("left", 0, 2), ("left", 10, 12))
    assert front[1].terminal_error == 0.01
    assert front[0].cost is None
    record = factory_run(starts, front)
    write_sweeps(tmp_path, [record])
    with open(tmp_path / STARTS_FILE, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["cost"] for row in rows] == ["4.0", ""]
    assert rows[0]["windows"] == "left:0-2"
    with open(tmp_path / FRONT, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["tolerance"] for row in rows] == ["0.0", "0.01"]
    assert rows[1]["windows"] == "left:0-2 left:10-12"
    write_sweeps(tmp_path, [])
    assert not (tmp_path / FRONT).exists()
    assert not (tmp_path / STARTS_FILE).exists()


@pytest.fixture
def factory_run():
    """A run record with these starts and front, from as little as the schema allows."""
    from reports.records.record import RunRecord, SceneRecord, StageRecord

    scene = SceneRecord(
        name="three_cart", title="", source="", coordinates=(), velocities=(), inputs=(), contacts=(), parameters=(), start=(), goal=(), step=0.01,
        steps=20,
    )  # fmt: skip

    def make(starts, front) -> RunRecord:
        stage = StageRecord(
            index=0, method="mpcc", method_title="", kind="direct", eps=None, outcome="solved", advice="", starts=starts, front=front
        )
        return RunRecord(
            key="k", scene=scene, pipeline="p", pipeline_title="", stages=(stage,), outcome="solved", must_hold=True, wall_seconds=0.0,
            cpu_seconds=0.0, provenance=gather("a test"),
        )  # fmt: skip

    return make
