"""The rule of a verdict on made-up metrics: when a limit is kept, how answers become a verdict, and what its sentence says."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.score import Metric, Question, Verdict, metric_names
from validate.judge.score.cause import ScoredPlan
from validate.judge.score.evidence import Evidence
from validate.judge.score.sentence import explain
from validate.judge.score.table import EXPLAINING, FEEDBACK, TABLE
from validate.judge.score.verdict import (
    EFFORT,
    SHARE,
    answers,
    compare,
    verdict_of,
    verdict_with_feedback,
    wants_feedback,
)

QUESTION = {entry.name: entry.question for entry in (*TABLE, *EXPLAINING)} | {
    EFFORT: Question.MOTION,
    SHARE: Question.MOTION,
}


@pytest.mark.parametrize(
    ("value", "error", "limit", "expected"),
    [
        (0.04, 0.0, 0.05, True),
        (0.05, 0.0, 0.05, True),  # a limit is the largest value that still holds
        (0.0501, 0.0, 0.05, False),
        (1e-9, 1e-4, 1e-2, True),  # an error far above the value, but far below the limit
        (0.0599, 1e-4, 0.06, None),
        (0.0601, 1e-4, 0.06, None),
        (0.0589, 1e-4, 0.06, True),  # eleven errors below
        (0.0611, 1e-4, 0.06, False),  # eleven errors above
        (0.0591, 1e-4, 0.06, None),  # nine errors below
        (0.0609, 1e-4, 0.06, None),  # nine errors above
        (0.0, 1e-3, 1e-6, None),  # an error larger than the limit decides nothing
        (5.0, math.inf, 0.06, None),
        (0.0, 0.0, 0.0, True),
    ],
)
def test_a_metric_is_judged_only_ten_errors_away_from_its_limit(
    value: float, error: float, limit: float, expected: bool | None
):
    assert compare(value, error, limit) is expected


def metric(
    name: str,
    ok: bool | None,
    value: float | None = 0.07,
    limit: float | None = 0.06,
    unit: str = "m",
    **more: object,
) -> Metric:
    question = QUESTION[name.removeprefix("tracked_")]
    return Metric(
        name=name, question=question, value=value, unit=unit, meaning="", ok=ok, limit=limit, **more
    )


def test_limits_are_those_of_metrics_that_have_one_with_its_reason():
    assert all(entry.default[1] for entry in TABLE if entry.default)
    assert set(metric_names()) == {*(entry.name for entry in TABLE), EFFORT, SHARE}


ABOVE = metric("replay_terminal_position_error", False)
BELOW = metric("replay_error", True)
OPEN = metric("max_penetration", None)
START = metric("start_error", True)
SHOWN = metric("physics", None, limit=None)
UNWELL = metric("answer_error", False, unit="1")
WELL = metric("answer_error", True, unit="1")


@pytest.mark.parametrize(
    ("metrics", "verdict"),
    [
        ((BELOW,), Verdict.HOLDS),
        ((BELOW, SHOWN), Verdict.HOLDS),
        ((BELOW, WELL), Verdict.HOLDS),
        ((ABOVE,), Verdict.VIOLATES),
        ((BELOW, ABOVE), Verdict.VIOLATES),
        ((OPEN, ABOVE), Verdict.VIOLATES),  # one that surely fails, even behind an undecided one
        ((metric("start_error", None), ABOVE), Verdict.VIOLATES),
        ((BELOW, OPEN), Verdict.UNDECIDED),
        ((BELOW, UNWELL), Verdict.UNDECIDED),  # it accuses the judge, never the plan
        ((BELOW, metric("answer_error", None)), Verdict.UNDECIDED),
        (
            (ABOVE, UNWELL),
            Verdict.UNDECIDED,
        ),  # what a judge who is not well says of the motion is not sure
        (
            (metric("start_error", False), UNWELL),
            Verdict.VIOLATES,
        ),  # but what the plan says of itself is
        ((metric("defect", False), UNWELL), Verdict.VIOLATES),
    ],
)
def test_truth_table(metrics: tuple[Metric, ...], verdict: Verdict):
    assert verdict_of(answers(metrics)) is verdict
    assert verdict_of(answers(metrics[::-1])) is verdict


def test_good_verdicts():
    assert {verdict for verdict in Verdict if verdict.is_good} == {
        Verdict.HOLDS,
        Verdict.HOLDS_WITH_FEEDBACK,
    }


def test_a_question_is_as_good_as_its_worst_metric():
    found = answers((BELOW, ABOVE, OPEN, START))
    assert found[Question.MOTION] == "no"
    assert found[Question.POSSIBLE] == "undecided"
    assert found[Question.TASK] == "yes"
    assert found[Question.SCHEME] == "not asked"
    assert Question.SHOWN not in found


DECLARED = metric("defect", True)


@pytest.mark.parametrize(
    ("metrics", "wanted"),
    [
        ((START, ABOVE), True),
        ((START, ABOVE, DECLARED), True),
        ((START, metric("replay_error", None), DECLARED), True),  # undecided for the inputs alone
        ((START, BELOW), False),  # they do: no feedback is needed
        ((START, ABOVE, metric("defect", False)), False),
        ((START, ABOVE, metric("defect", None)), True),
        ((metric("start_error", False), ABOVE), False),  # feedback mends no start,
        ((metric("terminal_position_error", False), ABOVE), False),  # no plan that does not arrive,
        ((metric("contact_law_error", False), ABOVE), False),  # no invented force,
        ((metric("law_error", False), ABOVE, DECLARED), False),  # no relaxed law
    ],
)
def test_feedback_is_tried_where_the_motion_is_missed_and_nothing_else_is_wrong(
    metrics: tuple[Metric, ...], wanted: bool
):
    assert wants_feedback(metrics) is wanted


def followed(**ok: bool | None) -> tuple[Metric, ...]:
    """A plan whose inputs alone surely miss the goal, and what feedback makes of it."""
    kept = {
        "tracked_replay_terminal_position_error": True,
        "tracked_replay_error": True,
        EFFORT: True,
        SHARE: True,
    } | ok
    return (START, ABOVE, BELOW, *(metric(name, value) for name, value in kept.items()))


@pytest.mark.parametrize(
    ("metrics", "verdict"),
    [
        (followed(), Verdict.HOLDS),
        (followed(tracked_replay_error=False), Verdict.VIOLATES),
        (followed(**{EFFORT: False}), Verdict.VIOLATES),  # it makes another plan
        (followed(**{SHARE: False}), Verdict.VIOLATES),
        (
            followed(tracked_max_penetration=False),
            Verdict.VIOLATES,
        ),  # question 5 is asked of it too
        (followed(tracked_replay_error=None), Verdict.UNDECIDED),
        (
            followed(tracked_energy_residual_relative=False),
            Verdict.UNDECIDED,
        ),  # its judge is not well
    ],
)
def test_questions_four_and_five_are_asked_of_the_replay_with_feedback(
    metrics: tuple[Metric, ...], verdict: Verdict
):
    assert verdict_of(answers(metrics)) is Verdict.VIOLATES, "for the inputs alone nothing changes"
    assert verdict_of(answers(metrics, with_feedback=True)) is verdict


@pytest.mark.parametrize(
    ("alone", "with_feedback", "verdict"),
    [
        (Verdict.VIOLATES, Verdict.HOLDS, Verdict.HOLDS_WITH_FEEDBACK),
        (Verdict.UNDECIDED, Verdict.HOLDS, Verdict.HOLDS_WITH_FEEDBACK),
        (Verdict.VIOLATES, Verdict.VIOLATES, Verdict.VIOLATES),
        (Verdict.UNDECIDED, Verdict.UNDECIDED, Verdict.UNDECIDED),
        (Verdict.VIOLATES, Verdict.UNDECIDED, Verdict.UNDECIDED),  # it may hold with feedback
        (Verdict.UNDECIDED, Verdict.VIOLATES, Verdict.UNDECIDED),  # it may hold alone
    ],
)
def test_the_verdict_of_both(alone: Verdict, with_feedback: Verdict, verdict: Verdict):
    sample = {Verdict.HOLDS: "yes", Verdict.VIOLATES: "no", Verdict.UNDECIDED: "undecided"}
    found = dict.fromkeys((question for question in Question if question.value), "yes") | {
        Question.MOTION: sample[with_feedback]
    }
    assert verdict_with_feedback(alone, found) is verdict


SCENE = load_scene("three_cart")


def replay_with_growth(amplification: float) -> Any:
    growth = SimpleNamespace(amplification=amplification)
    return SimpleNamespace(growth=growth, ok=False, tracked=None)


def scored(
    *metrics: Metric, scheme: Scheme | None = Scheme.SEMI_IMPLICIT_EULER, **more: Any
) -> ScoredPlan:
    """Return a plan that stands still and violates by these metrics; more: of other fields.

    growth: amplification of the replay; grid_errors: of the evidence.
    """
    steps = SCENE.task.steps
    states, forces = np.zeros((steps + 1, 3)), np.zeros((steps, 2))
    plan = Trajectory(
        t=uniform_grid(SCENE.task.step, steps),
        q=states,
        v=states,
        u=forces,
        lam=forces,
        scheme=scheme,
    )
    growth, replay = more.pop("growth", None), more.pop("replay", None)
    case = Evidence(
        more.pop("scene", SCENE), plan, replay if growth is None else replay_with_growth(growth)
    )
    if (errors := more.pop("grid_errors", None)) is not None:
        case.__dict__["grid_errors"] = errors
    fields = {"verdict": Verdict.VIOLATES, "questions": answers(metrics)} | more
    return ScoredPlan(case=case, metrics={item.name: item for item in metrics}, **fields)


def told(*metrics: Metric, **more: Any) -> str:
    return explain(scored(*metrics, **more))[0]


MISS = metric("replay_terminal_position_error", False, value=0.27)
STRAY = metric("replay_error", False, value=0.2)
TRUE = metric("physics_scaled", True, value=0.0, limit=1e-5, unit="s")


def test_a_relaxed_law_is_named_before_what_follows_from_it():
    why = told(
        metric("physics_scaled", False, value=0.7, limit=1e-5, unit="s"),
        MISS,
        metric("ghost_impulse", False, 3.1, 0.1, "N s"),
    )
    assert not unsaid(
        why,
        "not those of contact: … 0.7 s (scaled), limit 1e-05 s; … 0.27 m … 0.06 m; … ghost_impulse.",
    )


@pytest.mark.parametrize(
    ("first", "says"),
    [
        (metric("start_error", False, value=0.1, limit=1e-6),
         "the plan starts 0.1 m … limit 1e-06 m; driven by"),
        (metric("bound_violation", False, value=47.0, limit=1e-6, unit="N"),
         "the inputs leave their bounds by 47 N, limit 1e-06 N; driven by"),
        (metric("terminal_position_error", False, value=0.5, limit=0.05),
         "the plan itself ends 0.5 m … limit 0.05 m; also above"),
    ],
)  # fmt: skip
def test_the_first_question_that_fails_speaks_first(first: Metric, says: str):
    assert not unsaid(told(TRUE, STRAY, MISS, first), says)


def test_explain_plan_without_scheme_says_nothing_of_grids():
    why = told(STRAY, scheme=None)
    assert "grid" not in why
    assert "time step" not in why
    unstable = told(STRAY, growth=549.0, scheme=None)
    assert not unsaid(unstable, "departs … by 0.2 m, limit 0.06 m; unstable … (amplification 550).")


def test_explain_undecided_cause_is_the_open_metric():
    blurred = metric("replay_error", None, 0.0599)
    for metrics, name in (((blurred,), blurred.name), ((blurred, UNWELL), UNWELL.name)):
        cause = explain(scored(*metrics, verdict=Verdict.UNDECIDED))[1]
        assert cause is not None
        assert (cause.code, cause.fields) == (name, {})


def test_the_other_hold_is_named_where_it_passes():
    assert not unsaid(
        told(STRAY, scheme=None, holds_as="`# hold: linear`"),
        "; it holds with another declaration: `# hold: linear`.",
    )


def test_what_is_undecided_says_why():
    unmeasured = metric("replay_error", None, value=None, reason="the plan was not replayed.")
    why = told(unmeasured, verdict=Verdict.UNDECIDED)
    assert not unsaid(why, "replay_error … not be measured: … not replayed.")
    blurred = metric("replay_error", None, value=0.0599, error=1e-4)
    why = told(blurred, OPEN, verdict=Verdict.UNDECIDED)
    assert not unsaid(
        why,
        "by 0.0599 m, limit 0.06 m, but … own error of 0.0001 m is not 10 times below the distance between them",
    )
    assert "nor decided: max_penetration" in why
    endless = metric("replay_error", None, value=0.01, error=math.inf)
    assert "the replay has no error estimate" in told(endless, verdict=Verdict.UNDECIDED)
    accused = told(BELOW, UNWELL, verdict=Verdict.UNDECIDED)
    assert not unsaid(accused, "the judge is not well … the replay is 0.07 tolerances off")


def test_what_holds_shows_the_metric_closest_to_its_limit():
    near = metric("replay_terminal_position_error", True, value=0.03)
    why = told(metric("defect", True, value=1e-9, limit=1e-6), near, verdict=Verdict.HOLDS)
    parts = (
        "every question asked is answered yes",
        "closest to its limit",
        "0.03 m from the goal, limit 0.06 m",
    )
    assert not unsaid(why, *parts)


def test_what_holds_with_feedback_says_what_the_inputs_alone_do_and_what_it_took():
    why = told(*followed(), growth=1005.0, verdict=Verdict.HOLDS_WITH_FEEDBACK)
    assert not unsaid(why, "not for the inputs alone: … ends 0.07 m … limit 0.06 m; unstable")
    assert not unsaid(why, "RMS effort 7 % … and 7 % of what the plan's own inputs do")
    assert "it holds: with feedback" in why
    why = told(
        *followed(),
        growth=1005.0,
        verdict=Verdict.HOLDS_WITH_FEEDBACK,
        scheme=None,
        holds_as="`# hold: linear`",
    )
    assert not unsaid(
        why,
        "limit 0.06 m; it holds with another declaration: `# hold: linear`; with LQR feedback",
    )


def test_what_is_waived_stands_in_every_sentence():
    assert told(STRAY, waived=("defect: its time step is another's",)).endswith(" Waived: defect.")


def test_a_metric_is_quoted_by_its_own_row():
    """One that judges has a sentence; without one its name will do."""
    judging = [entry for entry in (*TABLE, *FEEDBACK) if entry.question is not Question.SHOWN]
    assert [entry.name for entry in judging if entry.quoted.count("{}") != 1] == []
    first = judging[0]
    assert first.quote("0.3 m") == first.quoted.replace("{}", "0.3 m")
    assert replace(first, quoted="").quote("0.3 m") == "start_error is 0.3 m"
