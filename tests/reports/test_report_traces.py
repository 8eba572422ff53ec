"""Motions come from the files beside a record; columns of a record are the same after writing and reading, and finite numbers."""

from __future__ import annotations

import base64
import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from reports.records.check_record import StoredRecord
from reports.records.record import LONGEST
from reports.traces import Motion, contact_phases

_FINITE = st.floats(allow_nan=False, allow_infinity=False)


def _record(factory, history: object) -> dict:
    record = factory.runs()[0].model_dump(mode="json")
    record["stages"][0]["history"] = history
    return record


@pytest.mark.slow
@given(numbers=st.lists(_FINITE))
def test_columns_come_back_to_the_bit(factory, numbers):
    listed = StoredRecord.model_validate(_record(factory, {"q": numbers})).root
    assert list(listed.stages[0].history["q"]) == numbers
    assert StoredRecord.model_validate_json(listed.model_dump_json()).root == listed


def _text(*numbers: float) -> str:
    return base64.b64encode(struct.pack(f"<{len(numbers)}d", *numbers)).decode()


@pytest.mark.parametrize(
    "column", ["[0.0]", _text(1.0)[:-4], _text(0.0, float("nan")), _text(float("inf")), [float("nan")], ["a"], {"0": 1.0}, None], ids=str
)
def test_what_is_no_column_is_refused(factory, column):
    with pytest.raises(ValidationError):
        StoredRecord.model_validate_json(json.dumps(_record(factory, {"q": column})))


def test_large_numbers_whose_sum_overflows_are_numbers(factory):
    record = StoredRecord.model_validate(_record(factory, {"q": _text(1.5e308, 1.5e308)})).root
    assert list(record.stages[0].history["q"]) == [1.5e308, 1.5e308]


def test_a_plan_and_its_replay_are_read_as_they_were_written(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    columns = {
        name: [float(place) for place in range(4)] for name in ("t", "q1", "q2", "q3", "gap_left", "pose_x_1", "pose_y_1", "pose_angle_1")
    }
    place = folder / "runs" / run.key
    factory.write_motion(place / "trajectory.nc", {**columns, "u1": [5.0, 6.0, 7.0]})
    moved = {**columns, "q2": [0.0, 1.5, 2.0, 3.25], "lam_right": [0.0, 1.0, 0.0, 0.0], "knots": [0, 2, 3], "applied_u1": [8.0, 9.0]}
    factory.write_motion(place / "replay.nc", moved)
    found = factory.motion(folder, run, run.stages[0])
    assert (found.tracked, found.problems) == (None, ())
    assert found.plan.t.tolist() == found.plan.columns["gap_left"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert found.plan.columns["u1"].tolist() == [5.0, 6.0, 7.0]
    assert {name: poses.tolist() for name, poses in found.plan.poses.items()} == {"left": [[place] * 3 for place in (0.0, 1.0, 2.0, 3.0)]}
    # The plan's nodes are rows 0, 2 and 3 of the replay: there it is at 0, 1 and 2, the replay at 0, 2 and 3.25 of q2, and so on.
    assert found.replay.columns["position_error"].tolist() == pytest.approx([0.0, 0.5, 1.0, 1.25])
    assert found.replay.columns["u1"].tolist() == [8.0, 8.0, 9.0, 9.0]
    assert contact_phases(found.replay, "right") == [(1.0, 2.0)]


def test_long_motions_are_thinned_with_their_ends(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    times = [float(place) for place in range(20_001)]
    factory.write_motion(folder / "runs" / run.key / "trajectory.nc", {"t": times, "q1": times, "u1": times[:-1]})
    plan = factory.motion(folder, run, run.stages[0]).plan
    assert len(plan.t) == LONGEST
    assert plan.t[[0, -1]].tolist() == [0.0, 20_000.0]
    assert plan.columns["q1"].tolist() == plan.t.tolist()
    assert plan.columns["u1"].tolist() == plan.t[:-1].tolist()


def test_a_stage_without_a_plan_has_no_motion_whatever_lies_there(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    assert factory.motion(folder, run, run.stages[0].model_copy(update={"has_plan": False})) == Motion()


def test_a_record_whose_columns_are_lists_is_read_as_before(factory):
    record = factory.runs()[0]
    data = record.model_dump(mode="json")
    for stage, own in zip(data["stages"], record.stages, strict=True):
        stage["history"] = {name: list(values) for name, values in own.history.items()}
    assert StoredRecord.model_validate_json(json.dumps(data)).root == record
