"""The judge on made-up plans: what it sees, what it cannot see, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from wording import saying, unsaid

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import SceneError, TrajectoryError, UnknownNameError
from models.fmu import build_fmu
from models.scene import Limit, Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay import Replay
from validate.judge.replay.run import replay
from validate.judge.score import Question, Score, Verdict, score
from validate.judge.score.table import TABLE

OWN = Scheme.SEMI_IMPLICIT_EULER

STEPS = 100


def _pushed() -> tuple[Scene, Trajectory]:
    """Three carts, pushed together for a second.

    The goal is where that ends, so the plan is exact on its grid.
    """
    scene = load_scene("three_cart").with_task(steps=STEPS, start=(2.0, 2.55, 3.1, 0.3, 0.0, -0.3))
    t = np.arange(STEPS) * 0.01
    u = np.column_stack([2.0 * np.sin(4 * t), -np.cos(3 * t)])
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01)
    goal = tuple(float(value) for value in (*rollout.q[-1], *rollout.v[-1]))
    return scene.with_task(goal=goal), Trajectory(
        t=uniform_grid(0.01, STEPS), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=OWN
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    return _pushed()[0]


@pytest.fixture(scope="module")
def plan() -> Trajectory:
    return _pushed()[1]


@pytest.fixture(scope="module")
def replayed(scene: Scene, plan: Trajectory) -> Replay:
    return replay(scene, build_fmu(load_scene("three_cart")), plan)


def answered(result: Score) -> dict[int, str]:
    """Question number -> answer."""
    return {question.number: answer for question, answer in result.questions if question.number}


def test_a_plan_under_the_true_law_holds(scene: Scene, plan: Trajectory, replayed: Replay):
    result = score(scene, plan, replayed)
    assert plan.lam.max() > 0.5
    assert result.verdict is Verdict.HOLDS, result.why
    assert answered(result) == dict.fromkeys(range(1, 7), "yes")
    assert (result.judged, result.waived, result.not_asked) == ("open", (), ())


def test_a_made_up_force_at_a_distance_is_a_ghost():
    """Carts half a metre apart, a planned 4 N on the left contact for 0.1 s: 0.4 N s from a distance."""
    steps = 20
    lam = np.zeros((steps, 2))
    lam[5:15, 0] = 4.0
    scene = load_scene("three_cart")
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), np.zeros((steps, 2)), 0.01)
    plan = Trajectory(
        t=uniform_grid(0.01, steps),
        q=rollout.q,
        v=rollout.v,
        u=np.zeros((steps, 2)),
        lam=lam,
        scheme=OWN,
    )
    result = score(scene, plan, replay(scene, build_fmu(load_scene("three_cart")), plan))
    assert result.value("ghost_impulse") == pytest.approx(0.4, rel=1e-12)
    assert result.value("missed_impulse") == 0.0
    assert result.value("defect") == pytest.approx(
        0.01 * 4.0
    )  # the plan did not let that force act: v misses by h*lam/m
    assert result.value("physics") == pytest.approx(10 * 4.0 * (4.0 + 30 * 0.5))
    assert answered(result)[3] == answered(result)[5] == answered(result)[6] == "no"
    assert result.verdict is Verdict.VIOLATES
    undeclared = score(
        scene, replace(plan, scheme=None), replay(scene, build_fmu(load_scene("three_cart")), plan)
    )
    assert undeclared.value("contact_law_error") == pytest.approx(0.4, rel=1e-12)
    assert undeclared.value("defect") is None
    assert answered(undeclared)[3] == "no"


def test_without_a_replay_only_a_violation_can_be_found(scene: Scene, plan: Trajectory):
    held = score(scene, plan, None)
    assert held.verdict is Verdict.UNDECIDED
    assert answered(held) == {
        1: "yes",
        2: "yes",
        3: "yes",
        4: "undecided",
        5: "undecided",
        6: "yes",
    }
    assert "the plan was not replayed" in held.why
    assert held.value("replay_error") is None
    assert score(scene, replace(plan, lam=plan.lam + 0.1), None).verdict is Verdict.VIOLATES


def test_a_replay_that_did_not_arrive_leaves_metrics_without_value_but_with_a_reason(
    scene: Scene, plan: Trajectory
):
    cut = replay(scene, build_fmu(load_scene("three_cart")), plan, event_budget=1)
    assert not cut.ok
    result = score(scene, plan, cut)
    metric = result.metric("replay_error")
    assert (metric.value, metric.ok, metric.limit) == (None, None, 0.02)
    assert "chatters" in metric.reason
    assert result.verdict is Verdict.UNDECIDED


def test_plan_replay_and_scene_must_belong_together(
    scene: Scene, plan: Trajectory, replayed: Replay
):
    short = Trajectory(
        t=plan.t[:11], q=plan.q[:11], v=plan.v[:11], u=plan.u[:10], lam=plan.lam[:10]
    )
    with pytest.raises(TrajectoryError, match="101 nodes are not the 11"):
        score(scene, short, replayed)
    with pytest.raises(TrajectoryError, match="it is of scene three_cart"):
        score(replace(scene, name="other_carts"), plan, replayed)


def test_a_name_that_no_metric_has_is_no_metric_that_was_not_measured(
    scene: Scene, plan: Trajectory, replayed: Replay
):
    found = score(scene, plan, replayed)
    assert found.value("replay_error") == found.metric("replay_error").value
    assert [
        found.value(name) for name in ("friction_violation", "tracked_replay_error", "grid_order")
    ] == [None] * 3
    for name, says in (
        ("replay_eror", "no metric 'replay_eror'; did you mean replay_error?"),
        ("beauty", "no metric 'beauty'; there are start_error,"),
    ):
        with pytest.raises(UnknownNameError, match=saying(says)):
            found.value(name)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("beauty", "'beauty', which is no metric; the metrics are start_error,"),
        ("replay_eror", "did you mean replay_error?"),
        ("terminal_error",
         "shown, not judged; limit terminal_position_error and terminal_velocity_error"),
        ("replay_terminal_error",
         "limit replay_terminal_position_error and replay_terminal_velocity_error"),
        ("physics", "shown, not judged; limit physics_scaled."),
        ("grid_error", "shown, not judged; limit replay_error, which it explains."),
        ("grid_order", "shown, not judged; leave it out."),
    ],
)  # fmt: skip
def test_a_limit_that_could_judge_nothing_is_refused_with_its_mend(
    scene: Scene, name: str, says: str
):
    wrong = replace(scene, limits=(*scene.limits, Limit(metric=name, value=1.0, reason="a test")))
    with pytest.raises(SceneError) as caught:
        score(wrong, None, None)
    assert not unsaid(caught.value, says)


def test_a_scene_cannot_forget_a_limit_but_waive_it(
    scene: Scene, plan: Trajectory, replayed: Replay
):
    """A force of 11 N where 10 N are allowed: found whatever the scene says, unless it says why not."""
    strong = replace(plan, u=np.where(np.arange(STEPS)[:, None] == 3, 11.0, plan.u), scheme=None)
    kept = tuple(limit for limit in scene.limits if "terminal" in limit.metric)
    assert score(replace(scene, limits=kept), strong, None).metric("bound_violation").ok is False
    waived = replace(
        scene,
        limits=(
            *kept,
            Limit(
                metric="bound_violation", value=None, reason="its motors are stronger for a moment"
            ),
        ),
    )
    found = score(waived, strong, None)
    assert found.metric("bound_violation").ok is None
    assert found.waived == ("bound_violation: its motors are stronger for a moment",)
    assert found.why.endswith(" Waived: bound_violation.")


def test_what_a_plan_does_not_say_is_not_asked(scene: Scene, plan: Trajectory, replayed: Replay):
    """The same plan without its forces and velocities: fewer claims, the same motion, and the same verdict."""
    silent = replace(plan, lam=np.zeros_like(plan.lam), missing=frozenset({"v", "lam"}))
    before, after = score(scene, plan, replayed), score(scene, silent, replayed)
    lost = {
        metric.name: metric.reason
        for metric in after.metrics
        if metric.value is None and before.value(metric.name) is not None
    }
    assert {
        "physics",
        "physics_scaled",
        "defect",
        "terminal_error",
        "terminal_velocity_error",
        "ghost_impulse",
        "missed_impulse",
    } <= set(lost)
    assert not unsaid(lost["physics_scaled"], "not say its contact forces")
    assert not unsaid(lost["terminal_velocity_error"], "not say its velocities")
    motion = [
        entry.name
        for entry in TABLE
        if entry.question is Question.MOTION and before.value(entry.name) is not None
    ]
    assert "replay_error" in motion
    assert {name: after.value(name) for name in motion} == {
        name: before.value(name) for name in motion
    }
    assert after.verdict is Verdict.HOLDS, after.why
    assert any(not unsaid(text, "not say its contact forces") for text in after.not_asked)
    assert not any("touches no contact" in text for text in after.not_asked), "it does"
    apart = replace(replayed, gap=np.abs(replayed.gap) + 0.1)
    assert [
        text
        for text in score(scene, silent, apart).not_asked
        if text.endswith("forces; the replayed motion touches no contact.")
    ]
    for told, found in ((plan, apart), (silent, None)):
        assert not any("touches no contact" in text for text in score(scene, told, found).not_asked)
    undeclared = score(scene, replace(silent, scheme=None), replayed)
    assert undeclared.verdict is Verdict.HOLDS, undeclared.why
    assert answered(undeclared)[6] == "not asked"


def test_inputs_alone_are_a_plan(scene: Scene, plan: Trajectory, replayed: Replay):
    still = np.tile(plan.q[:1], (STEPS + 1, 1))
    alone = Trajectory(
        t=plan.t,
        q=still,
        v=np.tile(plan.v[:1], (STEPS + 1, 1)),
        u=plan.u,
        lam=0.0 * plan.lam,
        missing=frozenset({"q", "v", "lam"}),
    )
    result = score(scene, alone, replayed)
    assert result.verdict is Verdict.HOLDS, result.why
    assert answered(result) == {
        1: "yes",
        2: "not asked",
        3: "not asked",
        4: "yes",
        5: "yes",
        6: "not asked",
    }


def test_the_words_holds_and_reasons_of_what_is_asked_nothing(
    scene: Scene, plan: Trajectory, replayed: Replay
):
    """A scene without a goal: nothing can hold.

    Who claims nothing is not judged, who claims a motion must be consistent.
    """
    kept = tuple(limit for limit in scene.limits if "terminal" not in limit.metric)
    free = replace(scene.with_task(goal=(None,) * 6), limits=kept)
    found = score(free, plan, replayed)
    assert (found.verdict, found.verdict.is_good) == (Verdict.CONSISTENT, False)
    assert not unsaid(found.why, "consistent", "asks for nothing", "a goal", "a limit on its cost")
    assert score(free, replace(plan, lam=plan.lam + 1.0), replayed).verdict is Verdict.VIOLATES
    silent = replace(plan, missing=frozenset({"q", "v", "lam"}), scheme=None)
    assert score(free, silent, replayed).verdict is Verdict.NOT_APPLICABLE
    priced = replace(free, limits=(*kept, Limit(metric="replay_cost", value=1e6, reason="a test")))
    assert score(priced, plan, replayed).verdict is Verdict.HOLDS


def test_three_steps_in_the_place_of_many_are_another_task(scene: Scene, plan: Trajectory):
    """Half the task's own step is the limit, whatever the plan's."""
    coarse = replace(
        plan, t=np.linspace(0.0, 1.2, 4), q=plan.q[:4], v=plan.v[:4], u=plan.u[:3], lam=plan.lam[:3]
    )
    found = score(scene, coarse, None)
    assert not unsaid(
        found.why, "differ in duration by 0.2 s, limit 0.005 s (it lasts 1.2 s, the task 1 s)"
    )
