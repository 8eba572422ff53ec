"""Of which of two replays a verdict is, and how metrics stand by question and end by end."""

import html
import re
from dataclasses import replace

from models.results.run import TrackedRecord
from models.results.verdict import Metric, Question
from reports.judged import end_of, questions_of
from reports.pages.table1 import conclude
from reports.render import write_single
from reports.rows import rows_of


def test_a_cold_cost_of_nought_is_no_whole_to_take_a_part_of(factory):
    cold, warm = (
        factory.run("strict", None, "strict_lcp"),
        factory.run("softplus_dc+strict", "softplus_dc", "strict_lcp"),
    )
    nothing = replace(cold, stages=(replace(cold.stages[0], cost=0.0),))
    text = " ".join(conclude(rows_of((nothing, warm), lambda run: "")))
    assert f"after softplus_dc cost {warm.stages[-1].cost:.2f}, 0.0032 m off the goal" in text


def followed(factory):
    """A stage that holds with feedback, not for its inputs alone."""
    (stage,) = factory.run("strict", None, "strict_lcp").stages

    def metric(name: str, value: float, **changes) -> Metric:
        return Metric(name=name, value=value, unit="m", meaning="m", **changes)

    both = (
        metric("cost", 7.0, question=Question.GOAL, reason="no way is known to be cheap"),
        metric("replay_error", 0.6, question=Question.MOTION, limit=0.01, ok=False),
        metric("replay_terminal_position_error", 0.5, question=Question.MOTION, limit=0.06, ok=False),
        replace(metric("contact_law_error", 1.0,
               question=Question.FORCES), value=None, reason="the plan declares a scheme"),
        metric("tracked_replay_error", 0.004, question=Question.MOTION, limit=0.01, ok=True),
        metric("tracked_replay_terminal_position_error", 0.002, question=Question.MOTION, limit=0.06, ok=True),
        metric("feedback_effort", 0.1, question=Question.MOTION, limit=0.25, ok=True),
        metric("energy_residual_relative", 1e-9, limit=1e-6, ok=True),
        metric("physics", 0.0),
    )  # fmt: skip
    replay = replace(stage.replay, judged="feedback")
    return replace(
        stage,
        metrics=both,
        verdict="holds with feedback",
        replay=replay,
        questions=factory.questions(),
    )


def test_metrics_stand_by_question_with_both_ends_side_by_side(factory):
    stage = followed(factory)
    found = {question.number or question.text: question for question in questions_of(stage)}
    (cost,) = found[2].metrics
    assert (cost.is_judged, cost.waived) == (False, "no way is known to be cheap")
    error, end, effort = found[4].metrics
    assert (error.name, error.alone.value, error.followed.value) == ("replay_error", 0.6, 0.004)
    assert (end.alone.ok, end.followed.ok) == (False, True)
    assert (effort.alone, effort.followed.value) == (None, 0.1)
    assert [view.name for view in found["Is the judge well?"].metrics] == [
        "energy_residual_relative"
    ]
    assert [view.name for view in found["Shown, not judged"].metrics] == ["physics"]


def test_the_end_of_a_stage_is_that_of_the_replay_that_is_judged(factory):
    stage, scene = followed(factory), factory.scene()
    assert stage.judged("replay_error").value == 0.004
    assert end_of(stage, scene) == "position 0.0020 m"
    assert end_of(stage, scene, tracked=False) == "position 0.50 m"
    free = replace(scene, goal=(None,) * len(scene.goal))
    bare = replace(stage, metrics=())
    assert (end_of(bare, free), end_of(bare, scene)) == ("free end", "")
    assert end_of(replace(bare, replay=None), free) == ""


def test_the_page_shows_questions_metrics_and_both_ends(factory, tmp_path):
    stage = followed(factory)
    replay = replace(
        stage.replay, tracked=TrackedRecord(error_estimate=1e-9, rms=(0.1, 0.1), peak=(0.3, 0.3))
    )
    stage = replace(
        stage, replay=replay, not_asked=("contact_law_error: the plan does not say its forces.",)
    )
    scene = replace(
        factory.scene(), waived=("cost: no way is known to be cheap",), unstable="It falls over."
    )
    run = factory.run(
        "strict", None, "strict_lcp", stages=(stage,), verdict="holds with feedback", scene=scene
    )
    page = write_single(factory.store(tmp_path / "all", [run])).read_text(encoding="utf-8")
    words = " ".join(
        html.unescape(
            re.sub(r"<(script|style)[^>]*>.*?</\1>|<[^>]*>", " ", page, flags=re.DOTALL)
        ).split()
    )
    for told in (
        "strict on three_cart ↻ holds with feedback",  # the head of the run
        "Nearest to its limit replay_error with feedback: 0.004 m, limit 0.01 m.",
        "Ends off the goal by position 0.0020 m",
        "inputs alone: position 0.50 m; with feedback: position 0.0020 m",  # the card
        "Metric Inputs alone With feedback Limit Reason of the limit 1. Is it a plan of this task? ✓ yes",
        "the answers are for the one with feedback",
        "0.6 m ✗ beyond 0.004 m ✓ within 0.01",
        "waived Waived by the scene: no way is known to be cheap",
        "Shown, not judged physics",
        "Not asked contact_law_error: the plan does not say its forces.",
        "Limits that this scene waives cost: no way is known to be cheap",
        "so that a plan which holds with feedback is enough here: It falls over.",
    ):
        assert told in words, told
