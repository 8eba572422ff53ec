"""What a verdict says: what each cause needs to be said, what keeps it unsaid, and how numbers are quoted."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.scene import Limit, Scene
from models.schemes import Scheme
from models.trajectory import Trajectory
from tests.validate.judge.score.test_score_verdict import (
    BELOW,
    MISS,
    SCENE,
    STRAY,
    metric,
    scored,
    told,
)
from validate.judge.judgement import judge
from validate.judge.score import Metric, Question, Verdict, score
from validate.judge.score.cause import find_cause, rounded
from validate.judge.score.evidence import Evidence
from validate.judge.score.sentence import percent, quote
from validate.judge.score.verdict import EFFORT


def test_feedback_that_fails_too_says_by_what():
    tracked: Any = SimpleNamespace(tracked="a replay", ok=True, growth=None)
    effort = metric(EFFORT, False, value=0.5, limit=0.25, unit="1")
    said = " With feedback too: the RMS effort of the feedback is 50 % of the half-range of the inputs, limit 25 %."
    assert told(MISS, effort, replay=tracked).endswith(said)
    assert "With feedback" not in told(MISS, replay=tracked)
    assert "With feedback" not in told(MISS, effort, replay=None)
    assert "With feedback" not in told(
        MISS, effort, replay=SimpleNamespace(tracked=None, ok=True, growth=None)
    )
    fine = metric("start_error", False, value=0.1, limit=1e-6)
    assert "With feedback" not in told(fine, BELOW, effort, replay=tracked), (
        "the inputs alone give the motion"
    )


def test_a_depth_is_blamed_on_the_contact_that_is_nearest_to_its_own_end():
    """0.3 of a cart of 0.5 m, and 0.1: the deeper of the two in shares of their depths."""
    deep = metric("max_penetration", False, value=0.6, limit=0.5)
    gap = np.array([[0.1, 0.2], [-0.1, -0.3], [0.0, 0.1]])
    left, right = SCENE.contacts
    for replay_gap, contact in ((gap, right), (gap[:, ::-1], left)):
        why = told(deep, replay=SimpleNamespace(ok=True, gap=replay_gap, tracked=None))
        assert not unsaid(
            why, f"contact {contact.name} ({contact.bodies[0]} and {contact.bodies[1]}) ends, "
        )
        assert contact.depth_reason in why
    for replayed in (None, SimpleNamespace(ok=False, gap=gap, tracked=None, growth=None)):
        assert "beyond the depth" not in told(deep, replay=replayed)
    assert "beyond the depth" not in told(
        deep,
        replay=SimpleNamespace(ok=True, gap=gap, tracked=None, growth=None),
        scene=SimpleNamespace(),
    )


@pytest.mark.parametrize(
    ("first", "says"),
    [
        (metric("defect", False), "does not satisfy … limit 0.06 m."),
        (metric("duration_error", False, unit="s"), " (it lasts 5 s, the task 5 s)"),
        (metric("bound_violation", False, unit="N"), "limit 0.06 N."),
        (metric("friction_violation", False, unit="N"), "limit 0.06 N."),
    ],
)
def test_each_metric_that_fails_first_has_its_cause(first: Metric, says: str):
    assert not unsaid(told(first), says)


@pytest.mark.parametrize(
    ("name", "unit", "value", "limit", "says"),
    [
        ("replay_cost", "1", 1668.87, 1670.54, "costs 1669, limit 1671."),
        ("replay_cost", "1", 1668.87, 1900.0, "costs 1.67e+03, limit 1.9e+03."),
        ("max_penetration", "m", 5.00001e-07, 5e-07, "by 5.00001e-07 m, limit 5e-07 m."),
        ("max_penetration", "m", 0.5 + 1e-12, 0.5, "by 0.5 m, limit 0.5 m."),
        (EFFORT, "1", 12.34, 12.3, "is 1234 % of the half-range of the inputs, limit 1230 %."),
    ],
)
def test_a_number_and_its_limit_have_the_digits_that_tell_them_apart(
    name: str, unit: str, value: float, limit: float, says: str
):
    assert quote(metric(name, False, value=value, limit=limit, unit=unit)).endswith(
        says.rstrip(".")
    )


def test_few_digits_named_for_forces_and_velocities_only():
    for name in ("contact_law_error", "contact_force_error", "velocity_error"):
        assert "; it may be the plan's own digits: its positions are given to 1" in told(
            metric(name, False)
        )
    assert "digits" not in told(metric("replay_error", False, value=0.42, limit=0.1), scheme=None)


@pytest.mark.parametrize(
    ("last", "digits"), [(2.5, "0.1"), (2.54, "0.01"), (2.504, "0.001"), (2.5004, None)]
)
def test_few_digits_are_those_of_all_positions(last: float, digits: str | None):
    first = metric("velocity_error", False)
    made = scored(first)
    q = made.case.trajectory.q.copy()
    q[0, 0] = last
    made = replace(made, case=Evidence(SCENE, replace(made.case.trajectory, q=q), None))
    assert find_cause(made, first).fields.get("digits") == digits


def test_law_error_of_a_plan_that_gives_its_motion_not_blamed_on_relaxed_contact():
    for name in (
        "law_error",
        "discrete_terminal_position_error",
        "discrete_terminal_velocity_error",
    ):
        assert told(metric(name, False), BELOW).endswith("limit 0.06 m.")


def test_ghost_impulse_without_a_grid_has_no_cause():
    ghost = metric("ghost_impulse", False, unit="N s")
    assert told(ghost).endswith("limit 0.06 N s.")


def test_coarse_grid_says_what_the_halved_step_gives():
    """Two halvings from 0.01 s."""
    first = metric("replay_terminal_position_error", False, value=0.08, limit=0.06)
    shown = [
        metric(name, None, value=value, limit=None)
        for name, value in (("grid_error", 0.09), ("grid_order", 1.0))
    ]
    why = told(first, *shown, grid_errors=[0.09, 0.03, 0.004])
    assert why.endswith(
        ": discretisation error 0.09 m; at h = 0.0025 s with these inputs held it is 0.004 m."
    )


def test_unstable_or_nothing_without_a_known_grid():
    unknown = metric("grid_error", None, value=None, limit=None)
    for others in ((), (unknown,)):
        assert told(STRAY, *others).endswith("limit 0.06 m.")
        assert "; unstable in the open loop (amplification 500)." in told(
            STRAY, *others, growth=500.0
        )
    broken = told(STRAY, metric("defect", False, value=2e-3, limit=1e-6, unit="m"))
    assert not unsaid(
        broken, "limit 0.06 m; it does not solve its declared scheme (residual 0.002 m); also"
    )


def test_motion_without_a_cause_says_where_it_leaves_the_plan():
    """The second cart leaves the plan at rest by 0.1 m a second."""
    t = SCENE.task.step * np.arange(SCENE.task.steps + 1)
    q = np.column_stack([0.0 * t, 0.1 * t, 0.0 * t])
    replayed = SimpleNamespace(q=q, knots=np.arange(len(t)), ok=True, growth=None, tracked=None)
    first = metric("replay_error", False, value=0.5, limit=0.06)
    assert not unsaid(
        told(first, replay=replayed), "limit 0.06 m; q2 is more than 0.06 m … from t = 0.61 s on."
    )


def test_undecided_for_the_last_reasons():
    alone = told(MISS, verdict=Verdict.UNDECIDED)
    assert not unsaid(
        alone, "ends 0.27 m from the goal, limit 0.06 m; whether feedback … not be decided."
    )
    blurred = told(
        MISS,
        metric("tracked_missed_impulse", None, value=0.04, limit=0.05, unit="N s", error=0.012),
        verdict=Verdict.UNDECIDED,
    )
    assert not unsaid(
        blurred,
        "could not be decided: with feedback … 0.04 N s … limit 0.05 N s, but … own error of 0.012 N s",
    )
    assert told(verdict=Verdict.UNDECIDED) == "no question could be decided."
    unsure = metric("energy_residual_relative", None, value=1.5, limit=1.0, unit="1", error=0.25)
    assert told(unsure, verdict=Verdict.UNDECIDED).endswith("limit 1, known to 0.25.")
    unknown = metric(
        "energy_residual_relative", None, value=None, limit=1.0, unit="1", reason="unseen."
    )
    assert not unsaid(
        told(unknown, verdict=Verdict.UNDECIDED),
        "the judge is not well … energy_residual_relative: unseen.",
    )
    blurred = metric("replay_error", None, value=0.0599, error=1e-4)
    decided = SimpleNamespace(error=SimpleNamespace(would_decide="a better FMU"), tracked=None)
    assert told(blurred, verdict=Verdict.UNDECIDED, replay=decided).endswith(
        "What would decide it: a better FMU."
    )
    assert "What would decide it" not in told(
        metric("replay_error", None, value=None), verdict=Verdict.UNDECIDED, replay=decided
    )


def test_what_an_fmu_shows_is_said_by_the_numbers_of_its_questions():
    asked = {
        Question.TASK: "yes",
        Question.MOTION: "yes",
        Question.GOAL: "not asked",
        Question.JUDGE: "yes",
    }
    fmu: Any = SimpleNamespace(task=SimpleNamespace(has_goal=False))
    assert told(BELOW, scene=fmu, verdict=Verdict.HOLDS, questions=asked).startswith(
        "holds for what this FMU shows (questions 1, 4); closest"
    )
    one = {Question.TASK: "yes"}
    assert (
        told(scene=fmu, verdict=Verdict.HOLDS, questions=one)
        == "holds for what this FMU shows (question 1)."
    )
    assert not unsaid(
        told(scene=fmu, verdict=Verdict.CONSISTENT, questions=one),
        "consistent for what this FMU shows (question 1); … give it a [goal]",
    )
    assert not unsaid(
        told(verdict=Verdict.CONSISTENT, questions=one),
        "consistent; … asks for nothing: no limit on its goal",
    )
    assert not unsaid(
        told(scene=fmu, verdict=Verdict.NOT_APPLICABLE),
        "inputs alone claim nothing, … asks for nothing: give it",
    )


def test_holds_zero_limit_is_not_the_closest():
    nothing = metric("start_error", True, value=0.0, limit=0.0)
    assert not unsaid(
        told(nothing, metric("replay_error", True, value=0.01), verdict=Verdict.HOLDS),
        "closest to its limit: driven by its inputs",
    )


def test_with_feedback_the_end_is_quoted_and_what_it_took():
    bare = told(
        metric("replay_error", None),
        metric(EFFORT, True, value=0.125, limit=0.25, unit="1"),
        verdict=Verdict.HOLDS_WITH_FEEDBACK,
    )
    assert not unsaid(
        bare,
        "not for the inputs alone: … by 0.07 m, limit 0.06 m; with LQR feedback, RMS effort 12 % … it holds.",
    )
    assert "unstable" not in told(MISS, growth=99.0, verdict=Verdict.HOLDS_WITH_FEEDBACK)
    tracked = metric("tracked_replay_error", True, value=0.01)
    assert not unsaid(
        told(tracked, verdict=Verdict.HOLDS_WITH_FEEDBACK),
        "it holds: with feedback … by 0.01 m, limit 0.06 m.",
    )


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.0, "0 %"),
        (0.1234, "12 %"),
        (9.99, "1e+03 %"),
        (10.0, "1000 %"),
        (123.4, "12000 %"),
        (-20.0, "-2000 %"),
    ],
)
def test_percents(value: float, said: str):
    assert percent(value) == said


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.344, "0.34"),
        (9.96, "10"),
        (5649.0, "5600"),
        (994_000.0, "990000"),
        (1e6, "1e+06"),
        (3.0, "3"),
    ],
)
def test_rounded_numbers(value: float, said: str):
    assert rounded(value) == said


def _pushed(
    law: ContactLaw = ContactLaw.RELU, eps: float | None = None, **parameters: float
) -> Trajectory:
    """The outer carts of three_cart pushed against the middle one, by the law of a scene with these parameters."""
    scene = SCENE.with_parameters(**parameters)
    u = np.tile([6.0, -4.0], (500, 1))
    rolled = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01, law=law, eps=eps)
    return Trajectory(
        t=0.01 * np.arange(501),
        q=rolled.q,
        v=rolled.v,
        u=u,
        lam=rolled.lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )


def _without_goal(scene: Scene) -> Scene:
    waived = tuple(
        Limit(metric=f"{of}terminal_{what}_error", value=None, reason="no plan here reaches it")
        for of in ("", "replay_")
        for what in ("position", "velocity")
    )
    return replace(
        scene,
        limits=(*(limit for limit in scene.limits if "terminal_" not in limit.metric), *waived),
    )


def test_forces_of_another_stiffness_or_unit_are_not_called_relaxed():
    scene = _without_goal(SCENE)
    left, right = (item.name for item in SCENE.contacts)
    exact, stiff, soft = _pushed(), _pushed(k=300.0), _pushed(k=3.0)
    one = replace(exact, lam=exact.lam * [1.0, 7.0])
    for plan, times in (
        (stiff, "10"),
        (soft, "0.1"),
        (replace(exact, lam=1e-3 * exact.lam), "0.001"),
        (one, f"1 ({left}), 7 ({right})"),
    ):
        for scheme in (Scheme.SEMI_IMPLICIT_EULER, None):
            why = score(scene, replace(plan, scheme=scheme), None).why
            assert not unsaid(
                why,
                f": they are {times} times what the contact law gives, as of another stiffness or unit",
            ), why
            assert "relaxed" not in why
    for relaxed in (
        _pushed(ContactLaw.SOFTPLUS, 1e-3),
        _pushed(ContactLaw.SOFTPLUS, 1e-3, k=300.0),
        replace(exact, lam=exact.lam + 0.5),
    ):
        assert not unsaid(score(scene, relaxed, None).why, ": a relaxed contact law; tighten eps")


@pytest.mark.slow
def test_velocities_of_another_motion_are_named():
    plan, scene = replace(_pushed(), scheme=None), _without_goal(SCENE)
    for v in (0.5 * plan.v, 0.0 * plan.v):
        why = judge(scene, replace(plan, v=v)).score.why
        assert "its velocities are not those of its positions" in why, why


@pytest.mark.slow
def test_angles_that_are_wrapped_are_told():
    scene, turn = _without_goal(load_scene("wall_pendulum")), 2.0 * np.pi
    steps, step = scene.task.steps, scene.task.step
    u = np.full((steps, 1), 0.5 * scene.inputs[0].upper)
    rolled = load_kernel(scene).rollout(np.array(scene.task.start), u, step)
    plan = Trajectory(t=step * np.arange(steps + 1), q=rolled.q, v=rolled.v, u=u, lam=rolled.lam)
    after = (np.arange(steps + 1) > steps // 2)[:, None] * turn
    for wrapped in (plan.q + turn, plan.q - 2.0 * turn, plan.q + after):
        for missing in (frozenset[str](), frozenset({"v", "lam"})):
            why = judge(scene, replace(plan, q=wrapped, missing=missing)).score.why
            assert (
                "; angle theta is wrapped: angles run on from the task's start (numpy.unwrap)"
                in why
            ), why
    for right in (
        plan,
        replace(plan, u=-plan.u),
        replace(plan, q=plan.q + 0.2 * turn),
        replace(plan, v=1e3 * plan.v),
        replace(plan, v=3e5 * plan.v),
    ):
        assert "wrapped" not in judge(scene, right).score.why
