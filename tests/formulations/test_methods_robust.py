"""Inputs for several worlds at once: the worlds by hand, the gradient by differences, and plans that end nearer in worlds they were not made for. Plans followed on finer steps: how far the motion departs, and the same task on those steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from formulations.grids import departure, finer_scene, motion_on_finer_steps, plan_of, scene_of
from formulations.pipelines import load_method, solve_scene
from formulations.shooting.options import RobustOptions
from formulations.shooting.worlds import DrawnWorld, WorldsObjective, drawn
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.goal import goal_state
from models.trajectory import Trajectory, uniform_grid

SCENE = load_scene("three_cart").with_task(steps=100, step=0.05)
KERNEL = load_kernel(SCENE)
LIMITS = np.repeat([0.06, 0.11], 3)


def pushed(steps: int = 100) -> np.ndarray:
    return np.tile([3.0, -2.0], (steps, 1)) * np.sin(np.linspace(0.0, 3.0, steps))[:, None]


def test_worlds_are_otherwise_by_up_to_their_sizes_both_ways():
    worlds = drawn(KERNEL, pushed(), 64, seed=3)
    values = (
        np.array([world.kernel.parameters_of(0.05) for world in worlds])
        / [item.value for item in SCENE.parameters]
        - 1.0
    )
    nominal = np.tile([item.nominal for item in SCENE.coordinates], 2)
    starts = (np.array([world.start.numpy() for world in worlds]) - SCENE.task.start) / nominal
    gains = np.array([world.gain.numpy() for world in worlds]) - 1.0
    for found, size in ((values, 0.05), (starts, 0.01), (gains, 0.02)):
        assert (found.min(axis=0) < -0.9 * size).all()
        assert (found.max(axis=0) > 0.9 * size).all()
        assert np.abs(found).max() <= size * (1.0 + 1e-9)
        assert np.abs(found.mean(axis=0)).max() < 0.05 * size
    delays = np.array([world.delay for world in worlds])
    assert 0.0 <= delays.min() < 0.05
    assert 0.95 < delays.max() <= 1.0
    noise = np.array([world.noise.numpy() for world in worlds])
    lower, upper = (
        np.array([getattr(item, side) for item in SCENE.inputs]) for side in ("lower", "upper")
    )
    width = np.where(np.isfinite(upper - lower), upper - lower, 2.0 * np.abs(pushed()).max(axis=0))
    np.testing.assert_allclose(noise.std(axis=(0, 1)), 0.01 * width, rtol=0.05)


def test_the_same_seed_draws_the_same_worlds_and_another_others():
    first, again, other = (drawn(KERNEL, pushed(), 4, seed=seed) for seed in (1, 1, 2))
    assert all(
        torch.equal(one.start, two.start) and torch.equal(one.noise, two.noise)
        for one, two in zip(first, again, strict=True)
    )
    assert not torch.equal(first[0].start, other[0].start)
    assert not torch.equal(first[0].noise, other[0].noise)


@pytest.mark.parametrize("delay", [0.0, 0.25, 1.0])
def test_inputs_arrive_late_by_a_part_of_a_step_times_their_gain(delay):
    kernel, u = KERNEL, pushed()
    world = DrawnWorld(
        kernel=kernel,
        start=torch.tensor(SCENE.task.start, dtype=torch.float64),
        gain=torch.tensor([1.1, 0.9], dtype=torch.float64),
        noise=torch.full((100, 2), 0.25, dtype=torch.float64),
        delay=delay,
    )
    before = np.vstack([u[:1], u[:-1]])
    motion = kernel.rollout(
        np.array(SCENE.task.start), (u + delay * (before - u)) * [1.1, 0.9] + 0.25, 0.05
    )
    np.testing.assert_allclose(
        world.end(torch.from_numpy(u)).numpy(),
        [*motion.q[-1], *motion.v[-1]],
        rtol=1e-12,
        atol=1e-12,
    )


def test_the_loss_is_the_cost_the_mean_miss_and_the_goal_and_its_gradient_that_of_differences():
    kernel, u = KERNEL, pushed()
    objective = WorldsObjective(kernel, u, RobustOptions(worlds=3, weight=2.0, seed=5))
    own = kernel.rollout(np.array(SCENE.task.start), u, 0.05)
    cost, goal = KERNEL.cost(own.q, own.v, u), goal_state(SCENE.task)
    misses = [
        (world.end(torch.from_numpy(u)).numpy() - goal) / LIMITS
        for world in drawn(KERNEL, u, 3, seed=5)
    ]
    mean = np.mean([np.sqrt(1.0 + miss @ miss) - 1.0 for miss in misses])
    missed = np.mean((np.concatenate([own.q[-1], own.v[-1]]) - goal) ** 2)
    assert objective.value(u) == pytest.approx(
        cost + 2.0 * cost * mean + 120.0 * cost / 0.06**2 * missed, rel=1e-12
    )
    gradient = objective.gradient()
    rng = np.random.default_rng(0)
    for _ in range(3):
        way = rng.standard_normal(u.shape)
        slope = (objective.value(u + 1e-6 * way) - objective.value(u - 1e-6 * way)) / 2e-6
        assert slope == pytest.approx(float((gradient * way).sum()), rel=1e-5)


def missed(plan: Trajectory, seed: int) -> np.ndarray:
    """How far the plan's inputs end from the goal, in limits, in 64 worlds."""
    ends = np.array(
        [
            world.end(torch.from_numpy(plan.u.copy())).numpy()
            for world in drawn(KERNEL, plan.u, 64, seed)
        ]
    )
    shares = (ends - goal_state(SCENE.task)) / LIMITS
    return np.maximum(np.linalg.norm(shares[:, :3], axis=1), np.linalg.norm(shares[:, 3:], axis=1))


@pytest.mark.slow
def test_a_robust_plan_meets_the_goal_and_arrives_in_more_worlds_it_was_not_made_for():
    alone = solve_scene(SCENE, "mpcc", time_limit=1e4)
    with load_method("robust").open(SCENE, {"worlds": 32}) as session:
        found = session.solve(eps=None, warm_start=alone.trajectory, time_limit=1e4)
    assert found.outcome is Outcome.SOLVED
    assert found.trajectory is not None
    assert alone.trajectory is not None
    assert found.residuals["terminal_error"] < 1e-6
    assert alone.cost is not None
    assert found.cost == pytest.approx(
        KERNEL.cost(found.trajectory.q, found.trajectory.v, found.trajectory.u)
    )
    assert alone.cost < found.cost < 1.5 * alone.cost
    before, after = missed(alone.trajectory, seed=77), missed(found.trajectory, seed=77)
    assert (after <= 1.0).sum() >= (before <= 1.0).sum() + 5
    nearer = (
        before - after
    )  # in each world; which optimum the descent ends in depends on the processor's rounding, that it is nearer must not
    assert nearer.mean() > 3.0 * nearer.std(ddof=1) / np.sqrt(nearer.size), (
        "beyond what the draw of the worlds explains"
    )


def test_a_plan_on_finer_steps_is_kept_on_them():
    finer = finer_scene(SCENE, 2)
    u = pushed(200)
    plan = plan_of(finer, load_kernel(finer).rollout(np.array(SCENE.task.start), u, 0.025), u)
    with load_method("robust").open(SCENE, {"worlds": 2, "max_iterations": 3}) as session:
        found = session.solve(eps=None, warm_start=plan, time_limit=1e4)
    assert found.trajectory is not None
    assert found.trajectory.steps == 200


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("cart_pole_walls", "needs feedback"),
        ("wall_pendulum", "limits no end"),
        ("three_cart", None),
    ],
)
def test_scenes_on_which_no_inputs_can_be_robust_are_refused(name, why):
    refusal = load_method("robust").accepts(load_scene(name))
    assert refusal is None if why is None else why in str(refusal)


SMALL = load_scene("three_cart").with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)


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
    """The small scene with the plan's own end for a goal, and no limits that count but these."""
    scene = SMALL.with_task(goal=(*plan.q[-1], *plan.v[-1]), steps=40, step=0.05)
    values = dict.fromkeys((limit.metric for limit in scene.limits), 1e9) | limits
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


def test_what_departs_is_counted_in_the_limits_of_the_scene():
    """Each limit by itself, and the largest of all; twice the limit, half the number.

    Coarser steps depart by what they are wrong.
    """
    coarse = _finer(1.5, fine=1)
    names = (
        "replay_error",
        "replay_terminal_position_error",
        "replay_terminal_velocity_error",
        "feedback_share",
    )
    alone = {
        name: departure(_ending_at(coarse, **{"feedback_share": 1e9, name: 0.01}), coarse)
        for name in names
    }
    assert all(value > 1e-2 for value in alone.values())
    assert departure(_ending_at(coarse, **dict.fromkeys(names, 0.01)), coarse) == pytest.approx(
        max(alone.values())
    )
    assert departure(
        _ending_at(coarse, replay_error=0.02, feedback_share=1e9), coarse
    ) == pytest.approx(alone["replay_error"] / 2.0)
    assert departure(_ending_at(coarse), coarse) == pytest.approx(
        alone["feedback_share"] * 0.01 / 0.5
    ), "half of the inputs, where no limit is set"
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
