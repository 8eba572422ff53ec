"""The one word of a verdict: why inputs do not give the motion, at each limit and just beside it, and what says its cause by its own name."""

from dataclasses import replace

import pytest

from tests.validate.judge.score.test_score_verdict import scored
from validate.judge.score import Metric, Question, Verdict
from validate.judge.score.cause import cause_of


def metric(
    name: str,
    value: float,
    question: Question = Question.SHOWN,
    limit: float | None = None,
    ok: bool | None = None,
) -> Metric:
    return Metric(
        name=name, question=question, value=value, unit="m", meaning="", limit=limit, ok=ok
    )


def cause(*metrics: Metric, forces: str = "not asked") -> str:
    """Of a plan that violates by these; forces: the answer to whether they are physical."""
    made = scored(*metrics, scheme=None, questions={Question.FORCES: forces})
    assert cause_of(replace(made, verdict=Verdict.HOLDS)) == ""
    return cause_of(made)


@pytest.mark.parametrize(
    ("law", "grid", "growth", "defect", "word"),
    [
        (2.0, 1.0, None, None, "relaxed contact"), (1.0, 1.0, None, None, "coarse grid"),
        (1.0, None, None, None, "motion"), (None, 1.0, None, None, "coarse grid"),
        (1.0, 2.0, 100.0, None, "unstable"), (1.0, 2.0, 99.9, None, "coarse grid"),
        (None, None, 100.0, None, "unstable"), (2.0, 1.0, 100.0, None, "relaxed contact"),
        (2.0, 1.0, 100.0, False, "defect"), (1.0, 2.0, None, True, "coarse grid"),
    ],
)  # fmt: skip
def test_why_inputs_do_not_give_the_motion(
    law: float | None, grid: float | None, growth: float | None, defect: bool | None, word: str
):
    shown = [
        metric(name, value)
        for name, value in (("law_error", law), ("grid_error", grid), ("amplification", growth))
        if value is not None
    ]
    shown += (
        [metric("defect", 1.0, Question.SCHEME, limit=1.0, ok=defect)] if defect is not None else []
    )
    for missed in ("replay_error", "replay_terminal_position_error"):
        assert cause(metric(missed, 2.0, Question.MOTION, limit=1.0, ok=False), *shown) == word


def test_of_the_motion_a_cost_says_its_cause_by_its_own_name():
    name = "replay_cost"
    assert (
        cause(metric(name, 2.0, Question.MOTION, limit=1.0, ok=False), metric("grid_error", 1.0))
        == name
    )


@pytest.mark.parametrize(
    "question", [Question.TASK, Question.GOAL, Question.FORCES, Question.POSSIBLE]
)
def test_what_fails_of_another_question_is_named_itself(question: Question):
    assert (
        cause(
            metric("ghost_impulse", 2.0, question, limit=1.0, ok=False), metric("grid_error", 1.0)
        )
        == "ghost_impulse"
    )


@pytest.mark.parametrize(
    ("law", "growth", "forces", "word"),
    [(2.0, 100.0, "yes", "unstable"), (2.0, 99.9, "yes", "relaxed contact"),
     (2.0, 100.0, "no", "relaxed contact"), (1.0, 100.0, "no", "unstable")],
)  # fmt: skip
def test_forces_of_contact_are_not_called_relaxed_where_errors_grow(
    law: float, growth: float, forces: str, word: str
):
    shown = [metric("law_error", law), metric("grid_error", 1.0), metric("amplification", growth)]
    assert (
        cause(
            metric("replay_error", 2.0, Question.MOTION, limit=1.0, ok=False), *shown, forces=forces
        )
        == word
    )


@pytest.mark.parametrize("name", ["ghost_impulse", "missed_impulse"])
def test_contact_elsewhere_than_planned_is_by_the_grid_where_the_planned_forces_are_those_of_contact(
    name: str,
):
    missed, grid, order = (
        metric(name, 2.0, Question.POSSIBLE, limit=1.0, ok=False),
        metric("grid_error", 1.0),
        metric("grid_order", 1.0),
    )
    assert cause(missed, grid, order, forces="yes") == "coarse grid"
    assert cause(missed, grid, order, metric("amplification", 100.0), forces="yes") == "unstable"
    assert (
        cause(missed, grid, order, forces="no")
        == cause(missed, grid, forces="yes")
        == cause(missed, order, forces="yes")
        == name
    )
