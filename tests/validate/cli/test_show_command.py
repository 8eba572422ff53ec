"""`show` tells the questions, both ends and what the scene leaves unasked, in the words of the report."""

import json
from pathlib import Path

import pytest

from reports.records.record import MetricRecord, TrackedRecord
from tests.reports import record_factory as factory
from validate.campaign.stored import stored_names, title_of
from validate.store.store import Store


def test_a_run_that_holds_with_feedback_shows_both_ends(cli, tmp_path: Path):
    run = factory.run("strict", None, "strict_lcp", verdict="holds with feedback")
    (stage,) = run.stages
    metrics = (
        MetricRecord(
            name="cost",
            value=-0.0,
            unit="1",
            meaning="m",
            question=2,
            reason="no way is known to be cheap",
        ),
        MetricRecord(
            name="replay_error", value=0.6, unit="m", meaning="m", question=4, limit=0.01, ok=False
        ),
        MetricRecord(
            name="tracked_replay_error",
            value=0.004,
            unit="m",
            meaning="m",
            question=4,
            limit=0.01,
            ok=True,
            error=1e-9,
        ),
    )
    replay = stage.replay.model_copy(
        update={"judged": "feedback", "tracked": TrackedRecord(error_estimate=1e-9)}
    )
    changes = {
        "verdict": "holds with feedback",
        "why": "with LQR feedback it holds.",
        "metrics": metrics,
        "replay": replay,
    }
    stage = stage.model_copy(
        update={**changes, "not_asked": ("ghost_impulse: the plan says no forces.",)}
    )
    scene = run.scene.model_copy(
        update={"waived": ("cost: no way is known to be cheap",), "unstable": "It falls over."}
    )
    folder = factory.store(
        tmp_path / "all", [run.model_copy(update={"stages": (stage,), "scene": scene})]
    )
    done = cli("show", "three_cart x strict", "--in", str(folder))
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert lines[0] == "three_cart x strict: solved, holds with feedback"
    for told in (
        "the last stage holds with feedback: with LQR feedback it holds.",
        "question, of the replay with feedback answer",
        "4 Do its inputs give its motion, and the goal? yes",
        "question metric inputs alone with feedback +- unit limit meaning reason of the limit",
        "2 cost 0 1 waived m no way is known to be cheap",
        "4 replay_error 0.6 0.004 1.0e-09 m 0.01 within m",
        "not asked: ghost_impulse: the plan says no forces.",
        "waived by the scene: cost: no way is known to be cheap",
        "the scene is unstable in the open loop: It falls over.",
    ):
        assert told in lines, told
    assert done.returncode == 0


def test_a_record_that_cannot_be_read_is_not_looked_for_elsewhere(cli, tmp_path: Path):
    run = factory.run("strict", None, "strict_lcp")
    folder = factory.store(tmp_path / "all", [run], factory.campaign([run]))
    record = folder / "runs" / run.key / "record.json"
    (folder / "runs" / run.key / "task.json").write_text(
        json.dumps({"task": {"scene_name": "three_cart", "pipeline": {"name": "strict"}}})
    )
    record.write_text(record.read_text()[:300])
    done = cli("show", "three_cart x strict", "--in", str(folder))
    assert done.returncode == 2
    assert f"{record} cannot be read" in " ".join(done.stderr.split())
    assert "did you mean" not in done.stderr


@pytest.mark.parametrize(
    ("task", "named"),
    [
        ({"scene_name": "three_cart", "pipeline": {"name": "mpcc"}}, "three_cart x mpcc"),
        ({"kind": "FMU", "name": "three_cart, FMI 2.0"}, "FMU: three_cart, FMI 2.0"),
        # Damaged: its record tells.
        ({"scene_name": "three_cart", "pipeline": {"title": "mpcc"}}, "three_cart x strict"),
        ({"scene_name": "three_cart", "pipeline": "mpcc"}, "three_cart x strict"),
        ({"pipeline": {"name": "mpcc"}}, "three_cart x strict"),
        ({}, "three_cart x strict"),
        ([1, 2], "three_cart x strict"),
    ],
)
def test_a_run_is_called_what_was_asked_for_and_only_else_what_its_record_says(
    task: object, named: str, tmp_path: Path
):
    run = factory.run("strict", None, "strict_lcp")
    store = Store(factory.store(tmp_path / "all", [run]))
    (store.runs / run.key / "task.json").write_text(json.dumps({"task": task}), encoding="utf-8")
    assert stored_names(store, [run.key, "no-such-key"]) == {run.key: named}


def test_the_record_and_what_was_asked_for_agree_on_the_name():
    run = factory.run("strict", None, "strict_lcp")
    assert run.title == title_of({"scene_name": "three_cart", "pipeline": {"name": "strict"}})
