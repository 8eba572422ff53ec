"""Plans followed on finer steps: how far the motion departs, and the same task on those steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formulations import grids
from formulations.grids import departure, finer_scene, motion_on_finer_steps, scene_of
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.default_limits import FEEDBACK_EFFORT, FEEDBACK_SHARE, REPLAY_ERROR
from models.trajectory import Trajectory, uniform_grid
from validate.judge.score.table import FEEDBACK, TABLE

SMALL = load_scene("three_cart").with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)

DEFAULTS = {
    "replay_error": REPLAY_ERROR,
    "feedback_share": FEEDBACK_SHARE,
    "feedback_effort": FEEDBACK_EFFORT,
}


def _finer(inputs: float, fine: int = 50) -> Trajectory:
    """A plan whose states are the true motion, stepped `fine` times in each of its steps."""
    u = np.full((40, 2), inputs) * [1.0, -1.0]
    motion = load_kernel(SMALL).rollout(
        np.array(SMALL.task.start), np.repeat(u, fine, axis=0), 0.05 / fine
    )
    return Trajectory(
        t=uniform_grid(0.05, 40),
        q=motion.q[::fine],
        v=motion.v[::fine],
        u=u,
        lam=motion.lam[::fine],
    )


def _ending_at(plan: Trajectory, **limits: float) -> Scene:
    """The small scene with the plan's own end for a goal, and no limits of its own that count but these."""
    scene = SMALL.with_task(goal=(*plan.q[-1], *plan.v[-1]), steps=40, step=0.05)
    kept = {limit.metric for limit in scene.limits} - set(DEFAULTS)
    values = dict.fromkeys(kept, 1e9) | limits
    return replace(
        scene,
        limits=tuple(
            replace(scene.limits[0], metric=name, value=value) for name, value in values.items()
        ),
    )


def test_a_plan_of_the_true_motion_does_not_depart():
    plan = _finer(1.5)
    assert (plan.lam > 0.0).any()
    scene = _ending_at(
        plan, replay_error=1e-6, replay_terminal_position_error=1e-6, feedback_share=1e-6
    )
    assert departure(scene, plan) < 1e-4


def test_the_motion_by_the_inputs_alone_needs_no_feedback():
    """On steps as coarse as these feedback does much, and its limit is not asked."""
    coarse = _finer(1.5, fine=1)
    tight = _ending_at(coarse, replay_error=0.5, feedback_share=1e-9)
    without = _ending_at(coarse, replay_error=0.5, feedback_share=1e9)
    assert departure(tight, coarse) <= 1.0
    assert departure(tight, coarse) >= departure(without, coarse) > 0.0
    narrow = _ending_at(coarse, replay_error=1e-3, feedback_share=1e-9)
    assert departure(narrow, coarse) > 1.0


def test_what_departs_is_counted_in_the_limits_of_the_scene(monkeypatch: pytest.MonkeyPatch):
    """Each limit of the motion with feedback by itself, and the largest of all; twice the limit, half the number.

    Coarser steps depart by what they are wrong.
    """
    monkeypatch.setattr(grids, "driven_motion", lambda *_: None)
    coarse = _finer(1.5, fine=1)
    goal = ("replay_terminal_position_error", "replay_terminal_velocity_error")
    names, open_ = (*goal, *DEFAULTS), dict.fromkeys(DEFAULTS, 1e9)
    alone = {name: departure(_ending_at(coarse, **open_ | {name: 0.01}), coarse) for name in names}
    assert all(value > 1e-2 for value in alone.values())
    assert departure(_ending_at(coarse, **dict.fromkeys(names, 0.01)), coarse) == pytest.approx(
        max(alone.values())
    )
    assert departure(_ending_at(coarse, **open_ | {"replay_error": 0.02}), coarse) == pytest.approx(
        alone["replay_error"] / 2.0
    )
    assert departure(_ending_at(coarse), coarse) == pytest.approx(
        max(alone[name] * 0.01 / limit for name, limit in DEFAULTS.items())
    ), "the judge's own limits, where the scene sets none"
    defaults = {entry.name: entry.default for entry in (*TABLE, *FEEDBACK)}
    assert {name: defaults[name][0] for name in DEFAULTS} == DEFAULTS
    finer = _finer(1.5, fine=10)
    assert departure(_ending_at(finer, feedback_share=0.01), finer) < 0.25 * alone["feedback_share"]


def test_a_motion_that_leaves_every_bound_is_lost():
    """Springs that are far too stiff for a fiftieth of the step."""
    plan = _finer(1.5)
    assert departure(_ending_at(plan).with_parameters(k=3e13), plan) == 1e6


def test_the_motion_on_finer_steps_is_one_of_the_finer_task_and_near_the_plan():
    """Its equations hold to rounding; with feedback it ends nearer to the plan than without.

    A motion that is lost is none.
    """
    plan = _finer(1.5, fine=1)
    scene = _ending_at(plan)
    finer = finer_scene(scene, 4)
    motion = motion_on_finer_steps(scene, plan, 4)
    assert (finer.task.steps, finer.task.step, finer.task.horizon) == (
        160,
        0.0125,
        scene.task.horizon,
    )
    assert motion.steps == 160
    rolled = load_kernel(finer).rollout(motion.start, motion.u, 0.0125)
    assert np.array_equal(rolled.q, motion.q)
    alone = load_kernel(finer).rollout(plan.start, np.repeat(plan.u, 4, axis=0), 0.0125)
    assert np.abs(motion.q[-1] - plan.q[-1]).max() < 0.5 * np.abs(alone.q[-1] - plan.q[-1]).max()
    assert motion_on_finer_steps(scene.with_parameters(k=3e13), plan, 4) is None


def test_the_same_inputs_cost_the_same_on_finer_steps():
    scene = load_scene("two_discs")  # its task weighs the last state too
    assert scene.task.final_cost != 0
    finer, u = (
        finer_scene(scene, 3),
        np.random.default_rng(1).normal(size=(scene.task.steps, scene.nu)),
    )
    q, v = np.ones((scene.task.steps + 1, scene.nq)), np.ones((scene.task.steps + 1, scene.nq))
    q_finer = np.ones((3 * scene.task.steps + 1, scene.nq))
    ours = load_kernel(finer).cost(q_finer, q_finer, np.repeat(u, 3, axis=0))
    assert ours == pytest.approx(load_kernel(scene).cost(q, v, u), rel=1e-12)


def test_the_task_on_a_plans_own_steps():
    """Three times as many steps: that task.

    One that is longer, or has no such number of steps, has none: it is refused where the task's
    grid is needed.
    """
    plan = _finer(1.5)
    scene = _ending_at(plan).with_task(steps=20, step=0.1)
    assert scene_of(scene, plan).task == finer_scene(scene, 2).task
    for other in (
        scene.with_task(steps=40, step=0.05),
        scene.with_task(step=0.11),
        scene.with_task(steps=30, step=2.0 / 30.0),
    ):
        assert scene_of(other, plan) is other
