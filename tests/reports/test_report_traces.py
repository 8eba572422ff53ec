"""Motions come from the files beside a record.

Columns of a record are the same after writing and reading, and finite numbers.
"""

import base64
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from wording import unsaid

from models.results.run import LONGEST, TrackedRecord
from models.results.stored import record_of, to_data, to_json
from reports.traces import Motion, at_all, contact_phases, read_plan

_FINITE = st.floats(allow_nan=False, allow_infinity=False)


def _record(factory, history: object) -> dict:
    record = to_data(factory.runs()[0])
    record["stages"][0]["history"] = history
    return record


@pytest.mark.slow
@given(numbers=st.lists(_FINITE))
def test_columns_come_back_to_the_bit(factory, numbers):
    listed = record_of(json.dumps(_record(factory, {"q": numbers})))
    assert list(listed.stages[0].history["q"]) == numbers
    assert record_of(to_json(listed)) == listed


def _text(*numbers: float) -> str:
    return base64.b64encode(struct.pack(f"<{len(numbers)}d", *numbers)).decode()


@pytest.mark.parametrize(
    "column",
    [
        "###",
        "[0.0]",
        "MTIz",
        _text(1.0)[:-4],
        _text(0.0, float("nan")),
        _text(float("inf")),
        [float("nan")],
        ["a"],
        {"0": 1.0},
        None,
    ],
    ids=str,
)
def test_what_is_no_column_is_refused(factory, column):
    with pytest.raises(ValidationError):
        record_of(json.dumps(_record(factory, {"q": column})))


def test_large_numbers_whose_sum_overflows_are_numbers(factory):
    record = record_of(json.dumps(_record(factory, {"q": _text(1.5e308, 1.5e308)})))
    assert list(record.stages[0].history["q"]) == [1.5e308, 1.5e308]


def test_a_plan_and_its_replay_are_read_as_they_were_written(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    columns = {
        name: [float(place) for place in range(4)]
        for name in ("t", "q1", "q2", "q3", "gap_left", "pose_x_1", "pose_y_1", "pose_angle_1")
    }
    place = folder / "runs" / run.key
    factory.write_motion(place / "trajectory.nc", {**columns, "u1": [5.0, 6.0, 7.0]})
    moved = {
        **columns,
        "q2": [0.0, 1.5, 2.0, 3.25],
        "lam_right": [0.0, 1.0, 0.0, 0.0],
        "knots": [0, 2, 3],
        "applied_u1": [8.0, 9.0],
        "position_error": [0.0, 1.0, 1.25],
    }
    factory.write_motion(place / "replay.nc", moved)
    found = factory.motion(folder, run, run.stages[0])
    assert (found.tracked, found.problems) == (None, ())
    assert found.plan.t.tolist() == found.plan.columns["gap_left"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert found.plan.columns["u1"].tolist() == [5.0, 6.0, 7.0]
    assert {name: poses.tolist() for name, poses in found.plan.poses.items()} == {
        "left": [[place] * 3 for place in (0.0, 1.0, 2.0, 3.0)]
    }
    # The plan's nodes are rows 0, 2 and 3 of the replay.
    assert found.replay.columns["position_error"].tolist() == pytest.approx([0.0, 0.5, 1.0, 1.25])
    assert found.replay.columns["u1"].tolist() == [8.0, 8.0, 9.0, 9.0]
    assert contact_phases(found.replay, "right") == [(1.0, 2.0)]


def test_long_motions_are_thinned_with_their_ends(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    times = [float(place) for place in range(20_001)]
    factory.write_motion(
        folder / "runs" / run.key / "trajectory.nc", {"t": times, "q1": times, "u1": times[:-1]}
    )
    plan = factory.motion(folder, run, run.stages[0]).plan
    assert len(plan.t) == LONGEST
    assert plan.t[[0, -1]].tolist() == [0.0, 20_000.0]
    assert plan.columns["q1"].tolist() == plan.t.tolist()
    assert plan.columns["u1"].tolist() == plan.t[:-1].tolist()


def test_a_stage_without_a_plan_has_no_motion_whatever_lies_there(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    assert factory.motion(folder, run, replace(run.stages[0], has_plan=False)) == Motion()


def of(factory, **trace):
    """Phases of contact of one trace at whole seconds."""
    length = max(len(values) for values in trace.values())
    return contact_phases(factory.trace(range(length), **trace), "left")


def test_phases_of_contact_begin_and_end_at_their_times(factory):
    assert of(factory, gap_left=(1, 0, 1, -1, -1)) == [(1, 2), (3, 4)]
    assert of(factory, gap_left=(-1, 1, 1)) == [(0, 1)]
    assert of(factory, gap_left=(1e-12, 1)) == []
    assert of(factory, lam_left=(0.001, 0.0011, 0.0, -0.0011)) == [(1, 2), (3, 3)]
    assert of(factory, left=(0.0, 2.0, 0.0)) == [(1, 2)], "a friction by its own name"
    assert of(factory, lam_left=(0.0, 1.0, 0.0), left=(5.0, 5.0, 5.0)) == [(1, 2)]
    assert contact_phases(None, "left") == []


def test_values_between_stored_times_are_linear_and_constant_beyond():
    assert at_all([0.0, 1.0, 3.0], [2.0, 4.0, 8.0], np.array([-1.0, 0.5, 2.0, 9.0])).tolist() == [
        2.0,
        3.0,
        6.0,
        8.0,
    ]
    assert at_all([0.0, 1.0, 3.0], [2.0, 4.0], np.array([0.5, 9.0])).tolist() == [3.0, 4.0]
    assert at_all([0.0, 1.0], [2.0, 4.0, 8.0], np.array([9.0])).tolist() == [4.0]


def written(factory, folder, run, **files):
    """What is read of a stage of which these files are written.

    The others lie there as the factory writes them.
    """
    factory.store(folder, [run])
    for what, columns in files.items():
        factory.write_motion(folder / "runs" / run.key / f"{what}.nc", columns)
    return factory.motion(folder, run, run.stages[-1])


def tracked_run(factory):
    run = factory.run("strict", None, "strict_lcp")
    (stage,) = run.stages
    replay = replace(stage.replay, tracked=TrackedRecord(error_estimate=1e-9))
    return replace(run, stages=(replace(stage, replay=replay),))


def test_each_motion_is_read_from_its_own_file(factory, tmp_path):
    run = tracked_run(factory)
    t = [0.0, 1.0, 2.0]
    found = written(
        factory, tmp_path, run, trajectory={"t": t, "q1": [1.0, 2.0, 3.0]},
        replay={"t": t, "q1": [4.0, 5.0, 6.0]},
        tracked={"t": t, "q1": [7.0, 8.0, 9.0], "u1": [1.0, 1.0, 1.0], "knots": [0, 1, 2],
                 "applied_u1": [5.0, 6.0], "position_error": [6.0, 6.0, 6.0]},
    )  # fmt: skip
    assert [
        trace.columns["q1"].tolist() for trace in (found.plan, found.replay, found.tracked)
    ] == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert found.tracked.columns["u1"].tolist() == [5.0, 6.0, 6.0]
    assert found.tracked.columns["position_error"].tolist() == [6.0, 6.0, 6.0]
    assert "position_error" not in found.replay.columns, "its nodes are not known"
    assert found.problems == ()
    stage = run.stages[0]
    assert found.judged(stage) is found.replay
    assert (
        found.judged(replace(stage, replay=replace(stage.replay, judged="feedback")))
        is found.tracked
    )
    assert read_plan(tmp_path / "runs" / run.key, run, stage).columns["q1"].tolist() == [1, 2, 3]
    assert read_plan(tmp_path / "runs" / run.key, run, replace(stage, has_plan=False)) is None


def test_files_that_cannot_be_read_are_told_and_the_others_shown(factory, tmp_path):
    run = tracked_run(factory)
    written(factory, tmp_path, run)
    place = tmp_path / "runs" / run.key
    (place / "replay.nc").unlink()
    (place / "tracked.nc").write_text("no file of numbers")
    found = factory.motion(tmp_path, run, run.stages[0])
    assert (found.replay, found.tracked, len(found.problems)) == (None, None, 2)
    assert not unsaid(found.problems[0], "replay.nc … no such file")
    assert found.problems[1].startswith("tracked.nc cannot be read (")
    assert len(found.problems[1]) < 200
    assert found.plan is not None
    (place / "trajectory.nc").unlink()
    assert read_plan(place, run, run.stages[0]) is None


@pytest.mark.parametrize(
    ("knots", "away", "error"),
    [([0, 1], [1.0, 2.0], [1.0, 2.0, 2.0]), ([0, 2], [1.0, 3.0], [1.0, 2.0, 3.0]),
     ([0, 3], [1.0, 3.0], None), ([-1, 2], [1.0, 3.0], None), ([], [], None),
     ([0, 1, 2], [1.0, 3.0], None)],
)  # fmt: skip
def test_the_error_is_linear_between_the_plans_nodes(factory, tmp_path, knots, away, error):
    run = factory.run("strict", None, "strict_lcp")
    replay = {"t": [0.0, 1.0, 2.0], "q1": [1.0, 2.0, 4.0]}
    if knots:
        replay |= {"knots": knots, "position_error": away}
    found = written(factory, tmp_path, run, replay=replay).replay
    told = found.columns.get("position_error")
    assert (None if told is None else told.tolist()) == error


def test_a_pose_is_a_constant_a_coordinate_or_a_column(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    shape = replace(run.scene.shapes[0], place=("q1", 0.5, None))
    run = replace(run, scene=replace(run.scene, shapes=(shape,)))
    columns = {"t": [0.0, 1.0], "q1": [3.0, 4.0], "pose_angle_1": [7.0, 8.0]}
    found = written(factory, tmp_path, run, trajectory=columns).plan
    assert found.poses["left"].tolist() == [[3.0, 0.5, 7.0], [4.0, 0.5, 8.0]]


def test_what_is_no_column_of_finite_numbers_is_missing(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    t = [0.0, 1.0, 2.0]
    one = {
        "pose_x_1": [5.0] * 3, "pose_y_1": [1.0, 2.0, 3.0], "pose_angle_1": [0.5] * 3,
        "pose_x_2": [1.0, 2.0], "pose_y_2": t, "pose_angle_2": t,
        "pose_x_3": t, "pose_y_3": t,
    }  # fmt: skip
    columns = {
        "t": t, "q1": [1.0, float("nan"), 2.0], "q2": [[1.0], [2.0], [3.0]],
        "q3": [1.0, 2.0, 3.0, 4.0], "u1": [1, 2], "other": t, **one,
    }  # fmt: skip
    found = written(factory, tmp_path, run, trajectory=columns).plan
    assert sorted(found.columns) == ["u1"]
    assert {name: poses.tolist() for name, poses in found.poses.items()} == {
        "left": [[5.0, 1.0, 0.5], [5.0, 2.0, 0.5], [5.0, 3.0, 0.5]]
    }
    assert written(factory, tmp_path / "none", run, trajectory={"q1": t}).plan is None
