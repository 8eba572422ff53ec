"""The judge on made-up plans: what it sees, what it cannot see, and what it refuses."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import SceneError, TrajectoryError
from models.fmu import build_fmu
from models.scene import Limit, Scene
from models.trajectory import Trajectory, uniform_grid
from validate.replay import Difference, Replay, ReplayError, replay
from validate.score import Verdict, score

STEPS = 100


def _pushed() -> tuple[Scene, Trajectory]:
    """Three carts, pushed together for a second; the goal is where that ends, so the plan is exact on its grid."""
    scene = load_scene("three_cart").with_task(steps=STEPS, start=(2.0, 2.55, 3.1, 0.3, 0.0, -0.3))
    t = np.arange(STEPS) * 0.01
    u = np.column_stack([2.0 * np.sin(4 * t), -np.cos(3 * t)])
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01)
    goal = tuple(float(value) for value in (*rollout.q[-1], *rollout.v[-1]))
    return scene.with_task(goal=goal), Trajectory(t=uniform_grid(0.01, STEPS), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return _pushed()[0]


@pytest.fixture(scope="module")
def plan() -> Trajectory:
    return _pushed()[1]


@pytest.fixture(scope="module")
def replayed(scene: Scene, plan: Trajectory) -> Replay:
    return replay(scene, build_fmu(load_scene("three_cart")), plan)


def changed(plan: Trajectory, **arrays: np.ndarray) -> Trajectory:
    return Trajectory(**{"t": plan.t, "q": plan.q, "v": plan.v, "u": plan.u, "lam": plan.lam, "hold": plan.hold, **arrays})


def test_a_plan_under_the_true_law_holds(scene: Scene, plan: Trajectory, replayed: Replay):
    result = score(scene, plan, replayed)
    assert plan.lam.max() > 0.5
    assert (result.verdict, result.contact, result.grid) == (Verdict.HOLDS, Verdict.HOLDS, Verdict.HOLDS), result.why


def test_a_made_up_force_at_a_distance_is_a_ghost():
    """Carts half a metre apart, a planned 4 N on the left contact for 0.1 s: 0.4 N s from a distance."""
    steps = 20
    lam = np.zeros((steps, 2))
    lam[5:15, 0] = 4.0
    scene = load_scene("three_cart")
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), np.zeros((steps, 2)), 0.01)
    plan = Trajectory(t=uniform_grid(0.01, steps), q=rollout.q, v=rollout.v, u=np.zeros((steps, 2)), lam=lam)
    result = score(scene, plan, replay(scene, build_fmu(load_scene("three_cart")), plan))
    assert result.value("ghost_impulse") == pytest.approx(0.4, rel=1e-12)
    assert result.value("missed_impulse") == 0.0
    assert result.value("defect") == pytest.approx(0.01 * 4.0)  # the plan did not let that force act: v misses by h*lam/m
    assert result.value("physics") == pytest.approx(10 * 4.0 * (4.0 + 30 * 0.5))
    assert result.contact is Verdict.VIOLATES


def test_other_start_and_broken_bounds_are_seen(scene: Scene, plan: Trajectory):
    moved = changed(plan, q=plan.q + 0.1)
    assert score(scene, moved, None).value("start_error") == pytest.approx(0.1)
    assert score(scene, moved, None).verdict is Verdict.VIOLATES
    strong = changed(plan, u=np.where(np.arange(STEPS)[:, None] == 3, 10.5, plan.u))
    assert score(scene, strong, None).value("bound_violation") == pytest.approx(0.5)


def test_without_a_replay_only_a_violation_can_be_found(scene: Scene, plan: Trajectory):
    held = score(scene, plan, None)
    assert held.verdict is Verdict.NOT_RESOLVED
    assert held.contact is Verdict.HOLDS
    assert held.grid is Verdict.NOT_RESOLVED
    assert "the plan was not replayed" in held.why
    assert held.value("replay_error") is None
    assert score(scene, changed(plan, lam=plan.lam + 0.1), None).verdict is Verdict.VIOLATES


def test_no_plan_is_a_verdict(scene: Scene):
    result = score(scene, None, None)
    assert (result.verdict, result.metrics) == (Verdict.NO_PLAN, ())


def test_a_replay_that_did_not_arrive_leaves_figures_without_value_but_with_a_reason(scene: Scene, plan: Trajectory):
    cut = replay(scene, build_fmu(load_scene("three_cart")), plan, event_budget=1)
    assert not cut.ok
    result = score(scene, plan, cut)
    figure = result.metric("replay_error")
    assert figure is not None
    assert (figure.value, figure.ok, figure.resolved) == (None, None, False)
    assert "chatters" in figure.reason
    assert result.verdict is Verdict.NOT_RESOLVED


def test_a_replay_too_coarse_for_its_limit_is_not_resolved(scene: Scene, plan: Trajectory, replayed: Replay):
    values = {field.name: getattr(replayed, field.name) for field in fields(Replay)}
    blurred = Replay(**{**values, "error": ReplayError(estimate=Difference(position=2e-3, state=6e-3, gap=1e-3))})
    result = score(scene, plan, blurred)
    assert result.verdict is Verdict.NOT_RESOLVED
    assert "own error of 0.006" in result.why
    unknown = Replay(**{**values, "error": ReplayError(estimate=None)})
    assert "no error estimate" in score(scene, plan, unknown).why


def test_a_plan_whose_own_time_step_blows_up_gets_a_reason_not_a_nan(scene: Scene):
    """h*c = 5: every step multiplies the velocity by -4."""
    damped = scene.with_parameters(c=500.0)
    plan = Trajectory(
        t=uniform_grid(0.01, 600), q=np.tile([2.0, 3.0, 4.0], (601, 1)), v=np.ones((601, 3)), u=np.zeros((600, 2)), lam=np.zeros((600, 2))
    )
    figure = score(damped, plan, None).figure("discrete_terminal_error")
    assert figure is not None
    assert (figure.value, figure.ok, figure.resolved) == (None, None, False)
    assert "diverges at step" in figure.reason


def test_unequal_steps_are_rolled_out_one_by_one(scene: Scene):
    t = np.concatenate([np.arange(10) * 0.01, 0.1 + np.arange(11) * 0.02])
    u = np.ones((20, 2))
    q, v = [np.array([2.0, 3.0, 4.0])], [np.zeros(3)]
    for h, force in zip(np.diff(t), u, strict=True):
        v.append(v[-1] + h * (np.array([force[0], 0.0, force[1]]) - 2 * v[-1]))
        q.append(q[-1] + h * v[-1])
    plan = Trajectory(t=t, q=np.array(q), v=np.array(v), u=u, lam=np.zeros((20, 2)))
    result = score(scene, plan, None)
    assert result.value("defect") == pytest.approx(0.0, abs=1e-14)
    assert result.value("law_error") == pytest.approx(0.0, abs=1e-13)


def test_plan_replay_and_scene_must_belong_together(scene: Scene, plan: Trajectory, replayed: Replay):
    short = Trajectory(t=plan.t[:11], q=plan.q[:11], v=plan.v[:11], u=plan.u[:10], lam=plan.lam[:10])
    with pytest.raises(TrajectoryError, match="101 nodes are not the 11"):
        score(scene, short, replayed)
    with pytest.raises(TrajectoryError, match="it is of scene three_cart"):
        score(replace(scene, name="other_carts"), plan, replayed)


def test_a_limit_on_an_unknown_figure_is_refused(scene: Scene):
    wrong = replace(scene, limits=(*scene.limits, Limit(metric="beauty", value=1.0, reason="")))
    with pytest.raises(SceneError, match="limit on 'beauty'"):
        score(wrong, None, None)


def test_what_a_plan_does_not_say_is_missing_not_wrong(scene: Scene, plan: Trajectory, replayed: Replay):
    """The same plan without its forces and velocities: what needs them has no value and a reason, the rest has the same value."""
    silent = replace(plan, lam=np.zeros_like(plan.lam), missing=frozenset({"v", "lam"}))
    before, after = score(scene, plan, replayed), score(scene, silent, replayed)
    assert all(figure.value is not None for figure in before.metrics)
    lost = {figure.name: figure.reason for figure in after.metrics if figure.value is None}
    assert set(lost) == {"physics", "physics_scaled", "defect", "terminal_error", "ghost_impulse", "missed_impulse"}
    assert "lam_left, lam_right" in lost["physics"]
    assert "velocities (v1, v2, v3)" in lost["terminal_error"]
    assert all(after.value(figure.name) == figure.value for figure in before.metrics if figure.name not in lost)
    assert after.verdict is Verdict.NOT_RESOLVED
    assert "does not say" in after.why


def test_a_disc_that_leaps_over_another_between_two_nodes_does_not_hold():
    """Six steps a second, none of which sees the other disc: exact on its own grid, and metres away from physics."""
    steps, step = 6, 1.0 / 6.0
    scene = load_scene("two_discs").with_task(steps=steps, step=step)
    start = np.array(scene.task.start)
    towards = start[2:4] - start[:2]
    u = np.zeros((steps, 2))
    u[0] = 1.6 * towards / step**2
    rollout = load_kernel(scene).rollout(start, u, step)
    assert not rollout.lam.any(), "it is over there before it has been here"
    plan = Trajectory(t=uniform_grid(step, steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam)
    result = score(scene, plan, replay(scene, build_fmu(scene), plan))
    assert result.verdict is Verdict.VIOLATES
    assert result.metric("law_error").ok is True
    assert result.metric("replay_error").ok is False
