"""Columns of numbers: the same after writing and reading, lists read as before, what is no column of finite numbers refused."""

from __future__ import annotations

import base64
import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from reports.records.check_record import StoredRecord
from reports.records.record import TraceRecord

_FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(_FINITE), st.lists(st.tuples(_FINITE, _FINITE, _FINITE)))
def test_columns_and_poses_come_back_to_the_bit(numbers, poses):
    times = (numbers + [1.0] * len(poses))[: max(len(numbers), len(poses))]
    trace = TraceRecord(t=times, columns={"q": tuple(numbers)}, poses={"body": poses})
    again = TraceRecord.model_validate_json(trace.model_dump_json())
    assert again == trace
    assert list(again.columns["q"]) == numbers
    assert list(again.poses["body"]) == poses
    listed = json.dumps({"t": times, "columns": {"q": numbers}, "poses": {"body": poses}})
    assert TraceRecord.model_validate_json(listed) == trace


def _text(*numbers: float) -> str:
    return base64.b64encode(struct.pack(f"<{len(numbers)}d", *numbers)).decode()


@pytest.mark.parametrize(
    "changes",
    [
        {"t": "[0.0]"},
        {"t": _text(1.0)[:-4]},
        {"t": _text(0.0, float("nan"))},
        {"t": _text(float("inf"))},
        {"t": [float("nan")]},
        {"t": ["a"]},
        {"t": {"0": 1.0}},
        {"t": None},
        {"poses": {"body": _text(1.0, 2.0)}},
        {"poses": {"body": [1.0, 2.0, 3.0]}},
        {"poses": {"body": [[1.0, 2.0]]}},
    ],
    ids=str,
)
def test_what_is_no_column_is_refused(changes):
    with pytest.raises(ValidationError):
        TraceRecord.model_validate_json(json.dumps({"t": [0.0, 1.0], "columns": {}} | changes))


@pytest.mark.parametrize(
    "changes", [{"columns": {"q": _text(1.0, 2.0, 3.0)}}, {"poses": {"body": [[0.0, 0.0, 0.0]] * 3}}], ids=["column", "poses"]
)
def test_what_is_longer_than_its_times_is_refused(changes):
    with pytest.raises(ValidationError, match="has 3 values at 2 times"):
        TraceRecord.model_validate({"t": [0.0, 1.0], "columns": {}} | changes)


def test_large_numbers_whose_sum_overflows_are_numbers():
    trace = TraceRecord.model_validate({"t": [0.0, 1.0], "columns": {"q": _text(1.5e308, 1.5e308)}})
    assert list(trace.columns["q"]) == [1.5e308, 1.5e308]


def test_a_record_whose_columns_are_lists_is_read_as_before(factory):
    record = factory.runs()[0]
    data = record.model_dump(mode="json")
    for stage, own in zip(data["stages"], record.stages, strict=True):
        stage["history"] = {name: list(values) for name, values in own.history.items()}
        for name in ("plan_trace", "replay_trace"):
            trace = getattr(own, name)
            stage[name] = trace and {
                "t": list(trace.t),
                "columns": {column: list(values) for column, values in trace.columns.items()},
                "poses": {body: list(poses) for body, poses in trace.poses.items()},
            }
    assert StoredRecord.model_validate_json(json.dumps(data)).root == record
