"""Why a plan has its verdict: the metric that decided it, the cause that the metrics show, and runs grouped by it."""

from __future__ import annotations

import pytest

from reports.causes import by_cause, cause_of, deciding
from reports.records.record import MetricRecord


def metric(name: str, value: float | None, limit: float | None = None, question: int | None = None, **changes) -> MetricRecord:
    said = {
        "unit": "m",
        "meaning": "",
        "question": question,
        "limit": limit,
        "ok": None if limit is None or value is None else value <= limit,
    }
    return MetricRecord(**{"name": name, "value": value, **said, **changes})


def ended(factory, verdict: str, *metrics: MetricRecord, name: str = "strict", outcome: str = "solved", **changes):
    run = factory.run("strict", None, "strict_lcp", key=f"{name}-0", verdict=verdict, outcome=outcome)
    (stage,) = run.stages
    said = {"verdict": verdict, "outcome": outcome, "metrics": metrics, "advice": "Do this.", "why": "the reason.", **changes}
    return run.model_copy(update={"pipeline": name, "stages": (stage.model_copy(update=said),)})


def test_the_first_question_that_fails_decides(factory):
    run = ended(
        factory, "violates", metric("replay_error", 2.0, 1.0, 4), metric("physics_scaled", 2.0, 1.0, 3), metric("start_error", 0.0, 1.0, 1)
    )
    assert deciding(run.stages[0]).name == "physics_scaled"


def test_of_a_plan_that_holds_the_metric_nearest_to_its_limit_is_named(factory):
    run = ended(
        factory,
        "holds",
        metric("start_error", 0.1, 1.0, 1),
        metric("replay_error", 0.9, 1.2, 4),
        metric("physics", 9.0),
        metric("judge", 0.99, 1.0),
    )
    assert deciding(run.stages[0]).name == "replay_error"
    assert cause_of(run) is None


def test_what_could_not_be_decided_is_named(factory):
    run = ended(
        factory,
        "undecided",
        metric("start_error", 0.1, 1.0, 1),
        metric("replay_error", 1.0, 1.0, 4, ok=None, error=0.5),
        cause="replay_error",
    )
    assert deciding(run.stages[0]).name == "replay_error"
    assert "replay error open" in cause_of(run).sentence


@pytest.mark.parametrize(
    ("cause", "begins"),
    [
        ("terminal_position_error", "The plan itself does not reach the goal (solved)"),
        ("physics_scaled", "Relaxed contact: the planned forces"),
        ("relaxed contact", "Relaxed contact: the inputs"),
        ("coarse grid", "Coarse grid"),
        ("unstable", "Unstable in the open loop"),
        ("motion", "The inputs do not give the planned motion"),
        ("defect", "The plan does not solve its own"),
        ("ghost_impulse", "Force at a distance"),
        ("cost", "The plan costs more than the scene allows (solved)"),
        ("replay_cost", "The plan costs more than the scene allows (solved)"),
        ("a_new_metric", "A limit is exceeded: a new metric"),
        ("", "Violates: the reason"),
    ],
)
def test_each_cause_has_its_sentence_and_an_advice(factory, cause, begins):
    found = cause_of(ended(factory, "violates", cause=cause))
    assert found.sentence.startswith(begins)
    assert found.advice


def test_a_run_without_a_plan_says_how_it_ended(factory):
    lost = ended(factory, "no plan", outcome="infeasible")
    assert (cause_of(lost).sentence, cause_of(lost).advice) == ("No plan: infeasible", "Do this.")
    crashed = lost.model_copy(update={"stages": (), "outcome": "time_limit"})
    assert cause_of(crashed).sentence == "No plan: time limit"
    assert "end of the log" in cause_of(crashed).advice


def test_each_cause_stands_once_the_most_frequent_first(factory):
    far = [ended(factory, "violates", cause="terminal_position_error", name=f"far {place}") for place in range(3)]
    ghost = ended(factory, "violates", cause="ghost_impulse", name="ghost")
    fine = [ended(factory, verdict, name=verdict) for verdict in ("holds", "holds with feedback", "consistent", "not applicable")]
    found = by_cause([ghost, far[0], *fine, far[1], far[2]])
    assert [[run.pipeline for run in runs] for _, runs in found] == [["far 0", "far 1", "far 2"], ["ghost"]]
    stalled = ended(factory, "violates", cause="terminal_position_error", name="stalled", outcome="stalled")
    assert len(by_cause([*far, stalled])) == 2, "what to do differs by how the method ended"
