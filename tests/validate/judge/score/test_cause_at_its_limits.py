"""Causes of a failure: each at its limit and just beside it, and the order of their tests."""

from typing import Any

import pytest

from tests.validate.judge.score.test_score_verdict import scored
from validate.judge.score import Metric, Question
from validate.judge.score.cause import CAUSES, Cause, find_cause


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


def failing(name: str, question: Question) -> Metric:
    return metric(name, 2.0, question, limit=1.0, ok=False)


MISSED = failing("replay_error", Question.MOTION)


def cause(first: Metric, *shown: Metric, forces: str = "not asked", **more: Any) -> Cause:
    plan = scored(
        first, *shown, questions={Question.FORCES: forces}, grid_errors=[0.8, 0.05], **more
    )
    return find_cause(plan, first)


GRID, ORDER = metric("grid_error", 1.0), metric("grid_order", 1.0)


@pytest.mark.parametrize(
    ("law", "grid", "order", "growth", "defect", "code"),
    [
        (2.0, 1.0, 1.0, None, None, "relaxed contact"), (1.0, 1.0, 1.0, None, None, "coarse grid"),
        (1.0, None, None, None, None, "motion"), (None, 1.0, 1.0, None, None, "coarse grid"),
        (1.0, 2.0, 0.5, None, None, "coarse grid"), (1.0, 2.0, 0.49, None, None, "motion"),
        (1.0, 2.0, None, None, None, "motion"),
        (1.0, 2.0, 1.0, 100.0, None, "unstable"), (1.0, 2.0, 1.0, 99.9, None, "coarse grid"),
        (None, None, None, 100.0, None, "unstable"),
        (2.0, 1.0, 1.0, 100.0, None, "relaxed contact"), (2.0, 1.0, 1.0, 100.0, False, "defect"),
        (1.0, 2.0, 1.0, None, True, "coarse grid"),
    ],
)  # fmt: skip
def test_find_cause_of_motion_first_test_that_passes(law, grid, order, growth, defect, code):
    values = {"law_error": law, "grid_error": grid, "grid_order": order}
    shown = [metric(name, value) for name, value in values.items() if value is not None]
    if defect is not None:
        shown.append(metric("defect", 1.0, Question.SCHEME, limit=1.0, ok=defect))
    for name in ("replay_error", "replay_terminal_position_error"):
        assert cause(failing(name, Question.MOTION), *shown, growth=growth).code == code


@pytest.mark.parametrize(
    "first",
    [
        failing("replay_cost", Question.MOTION), failing("bound_violation", Question.TASK),
        failing("terminal_position_error", Question.GOAL),
        failing("friction_violation", Question.FORCES),
        failing("replay_velocity_bound_violation", Question.POSSIBLE),
    ],
    ids=lambda first: first.name,
)  # fmt: skip
def test_find_cause_other_metrics_are_their_own_cause(first: Metric):
    found = cause(first, GRID, ORDER, growth=1e6)
    assert (found.code, found.fields, found.sentence) == (first.name, {}, "")


@pytest.mark.parametrize(
    ("law", "growth", "forces", "code"),
    [(2.0, 100.0, "yes", "unstable"), (2.0, 99.9, "yes", "relaxed contact"),
     (2.0, 100.0, "no", "relaxed contact"), (1.0, 100.0, "no", "unstable")],
)  # fmt: skip
def test_find_cause_correct_forces_unstable_not_relaxed(law, growth, forces, code):
    shown = (metric("law_error", law), GRID, ORDER)
    assert cause(MISSED, *shown, forces=forces, growth=growth).code == code


@pytest.mark.parametrize("name", ["ghost_impulse", "missed_impulse"])
def test_find_cause_impulse_of_correct_forces_is_by_the_grid(name: str):
    missed = failing(name, Question.POSSIBLE)
    assert cause(missed, GRID, ORDER, forces="yes").code == "coarse grid"
    assert cause(missed, GRID, ORDER, forces="yes", growth=100.0).code == "unstable"
    assert cause(missed, GRID, ORDER, forces="no").code == name
    assert cause(missed, GRID, forces="yes").code == name


def test_find_cause_declaration_before_all_of_motion():
    found = cause(MISSED, GRID, ORDER, growth=1e6, holds_as="`# hold: linear`")
    assert (found.code, found.fields) == ("declaration", {"line": "`# hold: linear`"})
    assert (
        cause(failing("ghost_impulse", Question.POSSIBLE), holds_as="`# hold: zero`").code
        != found.code
    )


def test_causes_are_a_dozen_sentences_with_named_fields():
    assert len(CAUSES) <= 12
    for code, (template, _) in CAUSES.items():
        assert "{" in template, code
    assert Cause("unstable", {"amplification": "550"}).sentence.endswith("(amplification 550)")
