"""The store: whole folders only, nothing lost, and what of it can be used again."""

import json

import pytest

from reports.records.record import LegRecord, RunRecord
from validate.execution.campaign import CampaignSettings, select, with_stored
from validate.execution.worker import record_for_crash
from validate.judge.score import metric_names
from validate.plan.runs import reasons
from validate.store.provenance import gather
from validate.store.results import COLUMNS, RESULTS, tables
from validate.store.store import Store
from validate.tasks.leg import place, write_leg
from validate.tasks.records import run_record, unfinished_stage
from validate.tasks.scene_record import scene_record
from validate.tasks.task import ChildExit, task_to_json


@pytest.fixture(scope="module")
def entry():
    """The cell three_cart x relu_gd of the real catalogs."""
    entries, _ = select(
        CampaignSettings(out=None, time_limit=600.0, scenes=("three_cart",), expression="relu_gd and not softplus and not relaxed")
    )
    (found,) = entries
    return found


def _record(entry, outcome: str, message: str = "") -> RunRecord:
    from formulations.solution import Outcome

    stages = [unfinished_stage("three_cart", "relu_gd", planned, Outcome[outcome.upper()], message) for planned in entry.loaded.plan]
    return run_record(entry.task, scene_record(entry.scene), stages, gather("test"), wall=1.0, cpu=1.0, log="a\nb")


def _stored(store: Store, entry, record: RunRecord, time_limit: float = 600.0) -> None:
    store.prepare()
    partial = store.open_partial(record.key, "token")
    (partial / "record.json").write_text(record.model_dump_json())
    (partial / "task.json").write_text(json.dumps({"task": {"time_limit": time_limit}}))
    store.commit(partial, record.key)


@pytest.mark.parametrize(
    ("outcome", "time_limit", "used_again"),
    [
        ("solved", 600.0, True), ("infeasible", 600.0, True), ("refused", 600.0, True), ("crashed", 600.0, False), ("time_limit", 600.0, True),
        ("time_limit", 599.0, False),
    ],
)  # fmt: skip
def test_what_is_used_again(tmp_path, entry, outcome, time_limit, used_again):
    store = Store(tmp_path)
    _stored(store, entry, _record(entry, outcome), time_limit)
    settings = CampaignSettings(out=tmp_path, time_limit=600.0)
    (found,) = with_stored([entry], store, settings)
    assert (found.stored is not None) is used_again
    (fresh,) = with_stored([entry], store, CampaignSettings(out=tmp_path, fresh=True))
    assert fresh.stored is None


@pytest.mark.parametrize(("time_limit", "used_again"), [(600.0, True), (599.0, False)])
def test_a_certificate_that_time_took_is_made_when_there_is_more(tmp_path, entry, time_limit, used_again):
    """The plans were kept, and with them the outcome of the last stage: it does not say that time ran out."""
    store, record = Store(tmp_path), _record(entry, "solved")
    partial = tmp_path / "run"
    (leg,) = entry.task.legs
    place(partial, 1).mkdir(parents=True)
    stages = tuple(stage.model_copy(update={"certificate_missing": True}) for stage in record.stages)
    write_leg(place(partial, 1), LegRecord(key=leg.key, pipeline="relu_gd", stages=stages, files={}))
    child = ChildExit(outcome="time_limit", message=f"ended at its time limit of {time_limit:g} s.", wall=time_limit, cpu=1.0, log="")
    kept = record_for_crash(entry.task, gather("test"), child, partial, entry.loaded)
    assert kept.outcome == "solved"
    _stored(store, entry, kept, time_limit)
    (found,) = with_stored([entry], store, CampaignSettings(out=tmp_path, time_limit=600.0))
    assert (found.stored is not None) is used_again


def test_results_have_the_columns_of_the_design(entry):
    design = (
        "scene, pipeline, stage, method, eps, outcome, cost, terminal_error, physics, physics_scaled, defect, discrete_terminal_error, "
        "replay_terminal_error, replay_terminal_position_error, replay_terminal_velocity_error, replay_error, max_penetration, ghost_impulse, "
        "missed_impulse, energy_residual, verdict, iterations, build_s, solve_s, stage_s, stage_cpu_s, total_s, replay_s, judged, "
        "tracked_replay_terminal_error, tracked_replay_error, feedback_effort, feedback_share, growth_rate"
    )
    first = tuple(design.split(", "))
    last = ("worlds", "share_arriving", "share_arriving_with_feedback", "weakest", "weakest_sizes")
    assert (*first, *(name for name in metric_names() if name not in first), *last) == COLUMNS
    assert len(set(COLUMNS)) == len(COLUMNS)
    header, row = tables([_record(entry, "infeasible")], (), ())[RESULTS].splitlines()
    assert header == ",".join(COLUMNS)
    told = {"scene": "three_cart", "pipeline": "relu_gd", "stage": "1", "method": "relu_gd", "outcome": "infeasible", "verdict": "no plan"}
    assert row.split(",") == [told.get(name, "") for name in COLUMNS]


HARMS = {
    "stored, but trajectory.nc is gone or cut off": lambda folder: (folder / "trajectory.nc").unlink(),
    "stored, but replay.nc is gone or cut off": lambda folder: (folder / "replay.nc").write_bytes(b""),
    "stored, but files.json is gone or cut off": lambda folder: (folder / "files.json").write_text("[1]"),
    "stored, but its record cannot be read": lambda folder: (folder / "record.json").write_text("{}"),
    "": lambda folder: (folder / "log.txt").unlink(missing_ok=True),
}


@pytest.mark.parametrize("why", HARMS)
def test_a_run_whose_files_are_gone_is_run_again(tmp_path, entry, why):
    """A result whose plan and replay nobody can look at any more is none."""
    store = Store(tmp_path)
    store.prepare()
    partial = store.open_partial(entry.task.key, "token")
    (partial / "record.json").write_text(_record(entry, "solved").model_dump_json())
    (partial / "task.json").write_text(json.dumps({"task": {**task_to_json(entry.task), "time_limit": 600.0}}))
    for name in ("trajectory.nc", "replay.nc"):
        (partial / name).write_bytes(name.encode())
    HARMS[why](store.commit(partial, entry.task.key))
    settings = CampaignSettings(out=tmp_path, time_limit=600.0)
    assert reasons(with_stored([entry], store, settings), store) == [why]
