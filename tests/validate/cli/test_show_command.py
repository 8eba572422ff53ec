"""`show` tells the questions, both ends and what the scene leaves unasked, in the words of the report."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from models.results.run import TrackedRecord
from models.results.verdict import Metric, Question
from reports.judged import cause_of_stage
from tests.reports import record_factory as factory
from validate.campaign.stored import stored_names, title_of
from validate.cli.verdict import print_score, print_verdict
from validate.store.store import Store


def test_a_run_that_holds_with_feedback_shows_both_ends(cli, tmp_path: Path):
    run = factory.run("strict", None, "strict_lcp", verdict="holds with feedback")
    (stage,) = run.stages
    metrics = (
        Metric(
            name="cost",
            value=-0.0,
            unit="1",
            meaning="m",
            question=Question.GOAL,
            reason="no way is known to be cheap",
        ),
        Metric(
            name="replay_error",
            value=0.6,
            unit="m",
            meaning="m",
            question=Question.MOTION,
            limit=0.01,
            ok=False,
        ),
        Metric(
            name="tracked_replay_error",
            value=0.004,
            unit="m",
            meaning="m",
            question=Question.MOTION,
            limit=0.01,
            ok=True,
            error=1e-9,
        ),
    )
    replay = replace(stage.replay, judged="feedback", tracked=TrackedRecord(error_estimate=1e-9))
    changes = {
        "verdict": "holds with feedback",
        "why": "with LQR feedback it holds.",
        "metrics": metrics,
        "replay": replay,
    }
    stage = replace(stage, **{**changes, "not_asked": ("ghost_impulse: the plan says no forces.",)})
    scene = replace(
        run.scene, waived=("cost: no way is known to be cheap",), unstable="It falls over."
    )
    folder = factory.store(tmp_path / "all", [replace(run, stages=(stage,), scene=scene)])
    done = cli("show", "three_cart x strict", "--in", str(folder), "--wide")
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert lines[:2] == [
        "holds with feedback: with LQR feedback it holds.",
        "closest to its limit: tracked_replay_error, 0.004 m, limit 0.01 m: m",
    ]
    for told in (
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


@pytest.mark.parametrize(
    ("value", "default", "limit"), [(None, True, ""), (None, False, "0.25"), (0.5, True, "0.25")]
)
def test_the_default_limit_of_what_could_not_be_measured_is_not_known(
    monkeypatch, capsys, value, default, limit
):
    """It is made of what could not be measured; a limit that the scene set is told."""
    monkeypatch.setenv("COLUMNS", "300")
    metric = Metric(
        name="max_penetration",
        value=value,
        unit="m",
        meaning="depth",
        question=Question.POSSIBLE,
        limit=0.25,
        default=default,
    )
    (stage,) = factory.run("strict", None, "strict_lcp").stages
    changes = {"metrics": (metric,), "not_asked": ()}
    print_score(replace(stage, **changes))
    heads, _, row = capsys.readouterr().out.splitlines()[-3:]
    place = re.search(r"\blimit\b", heads)
    assert place is not None
    assert row[place.start() - 2 : place.end() + 1].strip() == limit


@pytest.mark.parametrize("width", [80, 100])
def test_verdict_metric_and_cause_come_before_a_table_that_fits(monkeypatch, capsys, width: int):
    monkeypatch.setenv("COLUMNS", str(width))
    beyond = Metric(
        name="replay_terminal_position_error",
        value=0.31,
        unit="m",
        meaning="distance of the end of the replay from the goal, in all positions",
        question=Question.MOTION,
        limit=0.01,
        ok=False,
        reason="a reason that is longer than a line of a terminal has room for " * 3,
    )
    (stage,) = factory.run("strict", None, "strict_lcp").stages
    changes = {"metrics": (beyond,), "verdict": "violates", "why": "it ends 0.31 m off."}
    stage = replace(stage, **(changes | {"cause": "coarse grid", "questions": ()}))
    print_verdict(stage.verdict, stage.why, stage, cause_of_stage(stage))
    print_score(stage)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "violates: it ends 0.31 m off."
    assert lines[1].startswith("decided by: replay_terminal_position_error, 0.31 m, limit 0.01 m")
    assert lines[3].startswith("cause: Coarse grid")
    assert any(line.startswith("question  metric") for line in lines[4:])
    assert max(map(len, lines)) <= width
    assert "replay_terminal_position_error" in " ".join(lines[4:]).split()
