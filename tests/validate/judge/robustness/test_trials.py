"""A plan in one world: against the judge, the reference and an integrator of the tests' own."""

import math
from dataclasses import replace

import numpy as np
import pytest

from models.catalog import load_scene
from models.errors import TrajectoryError
from models.scene import Limit
from models.trajectory import Trajectory
from validate.judge.judgement import Judgement, judge
from validate.judge.replay.result import ReplayOutcome
from validate.judge.robustness.trials import Arena, Asked, WorldTrial
from validate.judge.robustness.worlds import World, draw, perturbations

SCENE = load_scene("three_cart")


def own_motion(plan: Trajectory, world: World) -> np.ndarray:
    """The last state of three carts: Runge and Kutta's fourth order, ten steps for one of the plan."""
    m, c, k, d = world.parameters

    def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        left, right = (k * max(0.0, d - gap) for gap in (x[1] - x[0], x[2] - x[1]))
        return np.array([*x[3:], *((np.array([u[0] - left, left - right, u[1] + right]) - c * x[3:]) / m)])

    x, h = np.array(world.start), 0.001
    for u in plan.u * world.gain + world.noise:
        for _ in range(10):
            a = rates(x, u)
            b = rates(x + h / 2 * a, u)
            e = rates(x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * e + rates(x + h * e, u))
    return x


def test_in_the_scenes_own_world_it_is_what_the_judge_found(judged: Judgement):
    assert judged.plan is not None
    with Arena.of(SCENE, judged.plan, judged.score) as arena:
        for trial in (arena.trial(arena.nominal), arena.checked(arena.nominal), arena.trial(arena.nominal)):
            for name, share in trial.shares.items():
                metric = judged.score.metric(name)
                assert share == pytest.approx(metric.value / metric.limit, abs=1e-4), name  # type: ignore[operator]
            assert trial.arrives
        assert len(trial.shares) == 3


@pytest.mark.slow
def test_worlds_end_where_an_integrator_of_the_tests_ends(judged: Judgement):
    plan = judged.plan
    assert plan is not None
    causes = [item for item in perturbations(SCENE, plan) if item.name != "delay"]
    worlds, arrived = draw(causes, 24, 7), []
    with Arena.of(SCENE, plan, judged.score) as arena:
        for number in range(24):
            world = worlds.world(number, arena.nominal)
            trial, own = arena.trial(world), own_motion(plan, world)
            assert trial.states[-1] == pytest.approx(own, abs=1e-5)
            arrived.append((trial.arrives, arena.asked.shares(own, trial.gaps)["replay_terminal_position_error"] <= 1.0))
    assert [mine for mine, _ in arrived] == [theirs for _, theirs in arrived]
    assert {mine for mine, _ in arrived} == {True, False}


def test_the_reference_says_the_same_with_delay_noise_and_feedback(judged: Judgement):
    assert judged.plan is not None
    worlds = draw(perturbations(SCENE, judged.plan), 8, 1)
    with Arena.of(SCENE, judged.plan, judged.score) as arena:
        for feedback in (False, True):
            for number in (0, 3, 7):
                world = worlds.world(number, arena.nominal)
                trial, reference = arena.trial(world, feedback=feedback), arena.checked(world, feedback=feedback)
                assert trial.states == pytest.approx(reference.states, abs=1e-5)
                assert trial.modes == reference.modes
        assert arena.trial(world, feedback=True).ratio < arena.trial(world).ratio, "it corrects what it sees"


def test_what_is_asked_is_told_in_shares_of_its_limits():
    asked = Asked(goal=np.array([1.0, math.nan, 0.0, 0.5]), position=0.1, velocity=0.2, depths=np.array([0.5, 0.1]))
    shares = asked.shares(np.array([1.05, 9.0, 0.06, 0.58]), np.array([[0.3, 0.2], [-0.1, 0.05], [0.1, -0.04]]))
    assert shares == {
        "replay_terminal_position_error": pytest.approx(0.5), "replay_terminal_velocity_error": pytest.approx(0.5), "max_penetration": pytest.approx(0.4)
    }  # fmt: skip
    assert asked.shares(np.array([1.0, 0.0, 0.0, 0.5]), np.array([[0.3, 0.2]]))["max_penetration"] == pytest.approx(-0.6)


def test_the_scene_says_how_deep_and_what_end_is_near_enough(judged: Judgement):
    own = Asked.of(SCENE, judged.score)
    assert (own.position, own.velocity, own.depths.tolist()) == (pytest.approx(0.06), pytest.approx(0.11), [0.5, 0.5])
    tighter = replace(SCENE, limits=(*SCENE.limits, Limit(metric="max_penetration", value=0.2, reason="the carts are soft")))
    assert Asked.of(tighter, judged.score).depths.tolist() == [0.2, 0.2]
    waived = replace(SCENE, limits=(*SCENE.limits, Limit(metric="max_penetration", value=None, reason="nobody looks")))
    assert Asked.of(waived, judged.score).depths.tolist() == [math.inf, math.inf]


def test_a_scene_without_an_end_is_refused():
    scene = load_scene("bouncing_mass")
    steps, start = 3, np.array(scene.task.start)
    plan = Trajectory(
        t=scene.task.step * np.arange(steps + 1), q=np.tile(start[: scene.nq], (steps + 1, 1)), v=np.tile(start[scene.nq :], (steps + 1, 1)),
        u=np.zeros((steps, scene.nu)), lam=np.zeros((steps, scene.nl)),
    )  # fmt: skip
    with pytest.raises(TrajectoryError, match=r"bouncing_mass.*no end"):
        Asked.of(scene, judge(scene, plan).score)


@pytest.mark.parametrize(
    ("shares", "outcome", "ratio", "arrives", "by"),
    [
        ({"a": 0.5, "b": 1.0}, ReplayOutcome.OK, 1.0, True, "b"),
        ({"a": 1.01, "b": -3.0}, ReplayOutcome.OK, 1.01, False, "a"),
        ({}, ReplayOutcome.DIVERGED, math.inf, False, "diverged"),
    ],
)
def test_a_trial_is_as_good_as_the_worst_of_what_is_asked(shares, outcome, ratio, arrives, by):
    gaps = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.2, 0.0], [-0.2, -0.1], [0.1, 0.1]])
    trial = WorldTrial(states=np.zeros((5, 2)), gaps=gaps, shares=shares, outcome=outcome)
    assert (trial.ratio, trial.arrives, trial.fails_by) == (ratio, arrives, by)
    assert trial.modes == ((), (0,), (0, 1), ())
