"""Causes of runs that do not hold: those that are metrics, and runs grouped by them."""

from dataclasses import replace

import pytest
from wording import unsaid

from models.results.verdict import Metric, Question
from reports.judged import by_cause, cause_of


def ended(factory, verdict: str, *, name: str = "strict", outcome: str = "solved", **changes):
    run = factory.run(
        "strict", None, "strict_lcp", key=f"{name}-0", verdict=verdict, outcome=outcome
    )
    (stage,) = run.stages
    said = {
        "verdict": verdict,
        "outcome": outcome,
        "metrics": (),
        "advice": "Do this.",
        "why": "the reason.",
        **changes,
    }
    return replace(run, pipeline=name, stages=(replace(stage, **said),))


@pytest.mark.parametrize(
    ("cause", "begins"),
    [
        ("replay_cost", "costs more than … allows (solved)"),
        ("a_new_metric", "A limit is exceeded: a new metric"),
    ],
)
def test_causes_that_are_metrics_have_a_sentence_and_an_advice(factory, cause, begins):
    found = cause_of(ended(factory, "violates", cause=cause))
    assert not unsaid(found.sentence, begins)
    assert found.advice


@pytest.mark.parametrize(
    ("cause", "ours", "others"),
    [
        ("contact_law_error", "eps", "lam_"), ("ghost_impulse", "eps", "lam_"),
        ("motion", "page of the run", "replay --html"),
        ("unstable", "best_exact", "feedback"), ("replay_cost", "best_exact", "another guess"),
    ],
)  # fmt: skip
def test_what_to_do_about_a_plan_of_somebody_elses_names_nothing_of_ours(
    factory, cause, ours, others
):
    assert not unsaid(
        cause_of(ended(factory, "violates", cause=cause, kind="indirect")).advice, ours
    )
    advice = cause_of(ended(factory, "violates", cause=cause, kind="given")).advice
    assert not unsaid(advice, others)
    assert unsaid(advice, ours)


def test_a_method_of_exact_contact_is_not_sent_to_exact_contact(factory):
    for outcome, advice in (
        ("solved", "Tighten the solver's tolerance, or take a smaller time step."),
        ("iteration_limit", "Do this."),
    ):
        assert (
            cause_of(
                ended(factory, "violates", cause="physics_scaled", kind="direct", outcome=outcome)
            ).advice
            == advice
        )


@pytest.mark.parametrize(
    ("outcome", "says"), [("stalled", "A local optimum"), ("iteration_limit", "Do this.")]
)
def test_a_plan_that_is_too_dear_is_a_local_optimum_unless_it_was_cut_off(factory, outcome, says):
    assert cause_of(
        ended(factory, "violates", cause="replay_cost", outcome=outcome)
    ).advice.startswith(says)


def test_each_cause_stands_once_the_most_frequent_first(factory):
    far = [
        ended(factory, "violates", cause="terminal_position_error", name=f"far {place}")
        for place in range(3)
    ]
    ghost = ended(factory, "violates", cause="ghost_impulse", name="ghost")
    fine = [
        ended(factory, verdict, name=verdict)
        for verdict in ("holds", "holds with feedback", "consistent", "not applicable")
    ]
    found = by_cause([ghost, far[0], *fine, far[1], far[2]])
    assert [[run.pipeline for run in runs] for _, runs in found] == [
        ["far 0", "far 1", "far 2"],
        ["ghost"],
    ]
    stalled = ended(
        factory, "violates", cause="terminal_position_error", name="stalled", outcome="stalled"
    )
    assert len(by_cause([*far, stalled])) == 2, "what to do differs by how the method ended"


@pytest.mark.parametrize("cause", ["unstable", "replay_cost"])
def test_advice_for_best_exact_does_not_name_it(factory, cause):
    run = ended(factory, "violates", cause=cause, kind="direct", method="best_exact")
    assert "best_exact" not in cause_of(run).advice


def test_cause_of_inputs_that_claim_no_motion_is_the_goal(factory):
    beyond = Metric(
        name="replay_terminal_velocity_error",
        value=0.3,
        unit="m/s",
        meaning="m",
        question=Question.MOTION,
        limit=0.1,
        ok=False,
    )
    run = ended(factory, "violates", cause="motion", kind="given", metrics=(beyond,))
    assert cause_of(run).sentence == "The inputs do not bring the motion to the goal"
