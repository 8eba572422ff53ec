"""A plan in one world: against the judge, the reference and an integrator of the tests' own."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from models.catalog import load_scene
from models.errors import TrajectoryError
from models.scene import Limit
from models.trajectory import Trajectory
from validate.judge.judgement import Judgement, judge
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import World
from validate.judge.robustness.trials import Asked, SceneArena, WorldTrial, asked_limits
from validate.judge.robustness.worlds import draw, moved, perturbations

SCENE = load_scene("three_cart")


def own_motion(plan: Trajectory, world: World) -> np.ndarray:
    """The last state of three carts: Runge and Kutta's fourth order, ten steps for one of the plan."""
    m, c, k, d = world.parameters

    def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        left, right = (k * max(0.0, d - gap) for gap in (x[1] - x[0], x[2] - x[1]))
        return np.array(
            [*x[3:], *((np.array([u[0] - left, left - right, u[1] + right]) - c * x[3:]) / m)]
        )

    x, h = np.array(world.start), 0.001
    for u in plan.u * world.gain + world.noise:
        for _ in range(10):
            a = rates(x, u)
            b = rates(x + h / 2 * a, u)
            e = rates(x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * e + rates(x + h * e, u))
    return x


def test_in_the_scenes_own_world_it_is_what_the_judge_found(judged: Judgement):
    with SceneArena.of(SCENE, judged.plan, asked_limits(judged.score)) as arena:
        for trial in (
            arena.trial(arena.nominal),
            arena.checked(arena.nominal),
            arena.trial(arena.nominal),
        ):
            for name, share in trial.shares.items():
                metric = judged.score.metric(name)
                assert share == pytest.approx(metric.value / metric.limit, abs=1e-4), name  # type: ignore[operator]
            assert trial.arrives
        assert len(trial.shares) == 3


@pytest.mark.slow
def test_worlds_end_where_an_integrator_of_the_tests_ends(judged: Judgement):
    plan = judged.plan
    causes = [item for item in perturbations(SCENE, plan) if item.name != "delay"]
    worlds, arrived = draw(causes, 24, 7), []
    with SceneArena.of(SCENE, plan, asked_limits(judged.score)) as arena:
        for number in range(24):
            world = worlds.world(number, arena.nominal)
            trial, own = arena.trial(world), own_motion(plan, world)
            assert trial.states[-1] == pytest.approx(own, abs=1e-5)
            arrived.append(
                (
                    trial.arrives,
                    arena.asked.shares(own[None], trial.gaps, 0.0)["replay_terminal_position_error"]
                    <= 1.0,
                )
            )
    assert [mine for mine, _ in arrived] == [theirs for _, theirs in arrived]
    assert {mine for mine, _ in arrived} == {True, False}


def test_the_reference_says_the_same_with_delay_noise_and_feedback(judged: Judgement):
    worlds = draw(perturbations(SCENE, judged.plan), 8, 1)
    with SceneArena.of(SCENE, judged.plan, asked_limits(judged.score)) as arena:
        for feedback in (False, True):
            for number in (0, 3, 7):
                world = worlds.world(number, arena.nominal)
                trial, reference = (
                    arena.trial(world, feedback=feedback),
                    arena.checked(world, feedback=feedback),
                )
                assert trial.states == pytest.approx(reference.states, abs=1e-5)
        assert arena.trial(world, feedback=True).ratio < arena.trial(world).ratio, (
            "it corrects what it sees"
        )


def test_what_is_asked_is_told_in_shares_of_its_limits():
    limits = {
        "replay_terminal_position_error": 0.1, "replay_terminal_velocity_error": 0.2,
        "replay_cost": 8.0, "replay_velocity_bound_violation": 0.01,
    }  # fmt: skip
    asked = Asked(
        limits=limits, goal=np.array([1.0, math.nan, 0.0, 0.5]), depths=np.array([0.5, 0.1]),
        lower=np.array([-1.0, -math.inf]), upper=np.array([2.0, math.inf])
    )  # fmt: skip
    motion = np.array([[0.0, 0.0, 2.002, 7.0], [0.0, 0.0, -1.005, -7.0], [1.05, 9.0, 0.06, 0.58]])
    shares = asked.shares(motion, np.array([[0.3, 0.2], [-0.1, 0.05], [0.1, -0.04]]), 6.0)
    assert shares == {
        "replay_terminal_position_error": pytest.approx(0.5),
        "replay_terminal_velocity_error": pytest.approx(0.5), "max_penetration": pytest.approx(0.4),
        "replay_cost": pytest.approx(0.75), "replay_velocity_bound_violation": pytest.approx(0.5),
    }  # fmt: skip
    assert asked.shares(motion[2:], np.array([[0.3, 0.2]]), 6.0)[
        "max_penetration"
    ] == pytest.approx(-0.6)
    assert (
        asked.shares(motion[2:], np.array([[0.3, 0.2]]), 6.0)["replay_velocity_bound_violation"]
        < 1.0
    ), "the end belongs to the goal"


@pytest.mark.parametrize(("limit", "cost", "arrives"),
                         [(8.0, 7.9, True), (8.0, 8.1, False), (-8.0, -8.1, True),
                          (-8.0, -7.9, False), (0.0, -0.1, True), (0.0, 0.1, False)])  # fmt: skip
def test_a_cost_may_be_limited_below_nothing(limit: float, cost: float, arrives: bool):
    nothing = np.zeros(0)
    asked = Asked(
        limits={"replay_cost": limit}, goal=nothing, depths=nothing, lower=nothing, upper=nothing
    )
    assert (asked.shares(np.zeros((1, 0)), np.zeros((1, 0)), cost)["replay_cost"] <= 1.0) is arrives


def test_where_the_end_is_free_what_the_motion_costs_is_asked():
    scene = load_scene("wall_pendulum")
    plan = {
        "t": scene.task.step * np.arange(scene.task.steps + 1),
        "u": np.full(scene.task.steps, -0.1),
    }
    judged = judge(scene, plan)
    metric = judged.score.metric("replay_cost")
    with SceneArena.of(scene, judged.plan, asked_limits(judged.score)) as arena:
        own = arena.trial(arena.nominal)
        assert own.shares["replay_cost"] == pytest.approx(metric.value / metric.limit, rel=1e-5)  # type: ignore[operator]
        gain = next(item for item in perturbations(scene, judged.plan) if item.name == "gain of u")
        stuck = arena.trial(moved(arena.nominal, [gain], np.array([-50.0])))
        fine = np.linspace(0.0, judged.plan.t[-1], 20001)
        motion = CubicHermiteSpline(judged.plan.t, *stuck.states.T)
        rate = motion(fine) ** 2 + motion(fine, 1) ** 2 + 0.1**2
        cost = np.trapezoid(rate, fine) / scene.task.step
        assert stuck.shares["replay_cost"] == pytest.approx(cost / metric.limit), (  # type: ignore[operator]
            "what is commanded is paid, whatever the actuator makes of it"
        )


@pytest.mark.slow
def test_feedback_does_nothing_in_the_scenes_own_world_as_its_plan_arrives_there(judged: Judgement):
    with SceneArena.of(SCENE, judged.plan, asked_limits(judged.score)) as arena:
        alone, followed = (
            arena.trial(arena.nominal, feedback=feedback) for feedback in (False, True)
        )
        assert followed.states == pytest.approx(alone.states, abs=1e-12)
        assert np.abs(alone.states - np.hstack([judged.plan.q, judged.plan.v])).max() > 1e-3, (
            "the grid of the plan is no disturbance"
        )


def test_the_scene_says_how_deep_and_what_end_is_near_enough(judged: Judgement):
    limits = asked_limits(judged.score)
    own = Asked.of(SCENE, limits)
    assert own.limits == {
        "replay_terminal_position_error": pytest.approx(0.06),
        "replay_terminal_velocity_error": pytest.approx(0.11),
    }
    assert own.depths.tolist() == [0.5, 0.5]
    tighter = replace(
        SCENE,
        limits=(
            *SCENE.limits,
            Limit(metric="max_penetration", value=0.2, reason="the carts are soft"),
        ),
    )
    assert Asked.of(tighter, limits).depths.tolist() == [0.2, 0.2]
    waived = replace(
        SCENE,
        limits=(*SCENE.limits, Limit(metric="max_penetration", value=None, reason="nobody looks")),
    )
    assert Asked.of(waived, limits).depths.tolist() == [math.inf, math.inf]


def test_a_scene_that_asks_for_nothing_is_refused():
    with pytest.raises(TrajectoryError, match=r"bouncing_mass.*no end.*replay_cost"):
        Asked.of(
            load_scene("bouncing_mass"),
            {"replay_error": 0.1, "replay_velocity_bound_violation": 0.1},
        )


@pytest.mark.parametrize(
    ("shares", "outcome", "ratio", "arrives", "by"),
    [
        ({"a": 0.5, "b": 1.0}, ReplayOutcome.OK, 1.0, True, "b"),
        ({"a": 1.01, "b": -3.0}, ReplayOutcome.OK, 1.01, False, "a"),
        ({}, ReplayOutcome.DIVERGED, math.inf, False, "diverged"),
    ],
)
def test_a_trial_is_as_good_as_the_worst_of_what_is_asked(shares, outcome, ratio, arrives, by):
    trial = WorldTrial(
        states=np.zeros((5, 2)), gaps=np.zeros((5, 0)), shares=shares, outcome=outcome
    )
    assert (trial.ratio, trial.arrives, trial.fails_by) == (ratio, arrives, by)
