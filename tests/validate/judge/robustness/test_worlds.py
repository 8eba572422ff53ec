"""What may be otherwise and by how much; what a plan's inputs become in a world, by hand."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from wording import unsaid

from models.catalog import load_scene
from models.errors import SceneError
from models.scene import Parameter
from models.trajectory import Hold, Trajectory
from validate.judge.replay.wiring import Feedback, World, WorldInputs
from validate.judge.robustness.worlds import (
    PerturbationKind,
    draw,
    moved,
    nominal_world,
    perturbations,
)

SCENE = load_scene("three_cart")


def plan(u: list[float], hold: Hold = Hold.ZERO_ORDER, u_end: float | None = None) -> Trajectory:
    """Of one coordinate and one input, a second a step."""
    nodes, column = len(u) + 1, np.array(u, dtype=float)[:, None]
    states = np.arange(float(nodes))[:, None]
    return Trajectory(
        t=np.arange(float(nodes)), q=states, v=0.0 * states, u=column, lam=np.zeros((len(u), 0)),
        hold=hold,
        u_end=None if u_end is None else np.array([u_end]),
    )  # fmt: skip


def resting() -> Trajectory:
    nodes = np.tile(SCENE.task.start, (501, 1))
    return Trajectory(
        t=0.01 * np.arange(501),
        q=nodes[:, :3],
        v=nodes[:, 3:],
        u=np.zeros((500, 2)),
        lam=np.zeros((500, 2)),
    )


def world(
    delay: float = 0.0, gain: float = 1.0, noise: list[float] | None = None, steps: int = 3
) -> World:
    added = np.zeros((steps, 1)) if noise is None else np.array(noise)[:, None]
    return World(
        parameters=np.zeros(0), start=np.zeros(2), gain=np.array([gain]), noise=added, delay=delay
    )


def following(given: Trajectory, most: float) -> Feedback:
    """Which adds what the position is behind the plan's, up to a bound of the input."""
    return Feedback(
        gains=np.tile([[1.0, 0.0]], (3, 1, 1)), reference=np.hstack([given.q, given.v]), u=given.u,
        lower=np.array([-9.0]), upper=np.array([most]),
        scale=np.ones(1),
    )  # fmt: skip


def test_sizes_are_those_of_the_rule():
    found = {item.name: (item.size, item.unit) for item in perturbations(SCENE, resting())}
    assert found == {
        "m": (0.05, "kg"), "c": (0.1, "N s/m"), "k": (1.5, "N/m"), "d": (0.025, "m"),
        **{f"start of q{i}": (0.01, "m") for i in (1, 2, 3)},
        **{f"start of v{i}": (0.01, "m/s") for i in (1, 2, 3)},
        "gain of u1": (0.02, "1"), "gain of u3": (0.02, "1"),
        "noise of u1": (pytest.approx(0.2), "N"), "noise of u3": (pytest.approx(0.2), "N"),
        "delay": (pytest.approx(0.01), "s"),
    }  # fmt: skip
    some = perturbations(SCENE, resting(), [PerturbationKind.GAIN, PerturbationKind.DELAY])
    assert [(item.name, item.nominal, item.below, item.above) for item in some] == [
        ("gain of u1", 1.0, 50.0, np.inf), ("gain of u3", 1.0, 50.0, np.inf),
        ("delay", 0.0, 0.0, np.inf)
    ]  # fmt: skip


def test_a_parameter_states_its_own_uncertainty_and_keeps_its_range():
    stated = replace(
        SCENE.parameters[0], uncertainty=0.3, uncertainty_reason="the carts were weighed by hand"
    )
    certain = replace(
        SCENE.parameters[2], uncertainty=0.0, uncertainty_reason="the spring was measured"
    )
    scene = replace(SCENE, parameters=(stated, SCENE.parameters[1], certain, SCENE.parameters[3]))
    found = {
        item.name: item for item in perturbations(scene, resting(), [PerturbationKind.PARAMETERS])
    }
    assert list(found) == ["m", "c", "d"], "what is certain is not perturbed"
    assert (found["m"].size, found["m"].reason) == (0.3, "the carts were weighed by hand")
    assert found["m"].below == pytest.approx((1.0 - 1e-6) / 0.3)
    far = moved(nominal_world(scene, resting()), [found["m"]], np.array([-100.0]))
    assert far.parameters == pytest.approx([1e-6, 2.0, 30.0, 0.5]), "no further than its range"


@pytest.mark.parametrize(
    ("uncertainty", "reason", "parts"),
    [
        (2.0, "wide", ["parameter mass", "2 kg", "[0.5, 2]"]),
        (-0.1, "less", ["at least 0"]),
        (0.1, "", ["uncertainty_reason"]),
    ],
)
def test_an_uncertainty_that_cannot_be_is_refused(
    uncertainty: float, reason: str, parts: list[str]
):
    with pytest.raises(SceneError) as told:
        Parameter(
            symbol=sp.Symbol("mass"),
            value=1.0,
            unit="kg",
            lower=0.5,
            upper=2.0,
            uncertainty=uncertainty,
            uncertainty_reason=reason,
        )
    assert not unsaid(told.value, *parts)


def test_worlds_are_spread_evenly_and_the_same_for_one_seed():
    causes = perturbations(SCENE, resting())
    found, again, other = (draw(causes, 256, seed) for seed in (3, 3, 4))
    assert found.points.shape == (256, 15)
    assert (found.points == again.points).all()
    assert (found.points != other.points).any(axis=0)[[0, 6, 11, 14]].all()
    both, one = found.points[:, :12], found.points[:, 14]
    assert -1.0 <= both.min() < -0.99
    assert 0.99 < both.max() <= 1.0
    assert np.abs(both.mean(axis=0)).max() < 0.01, "a random draw of 256 is off by 0.04"
    assert (one.min() >= 0.0, one.mean()) == (True, pytest.approx(0.5, abs=0.005))
    assert (found.points[:, 12:14] == 1.0).all(), "noise is of its own size in every world"


def test_a_world_is_moved_by_its_sizes_with_noise_of_its_own():
    nominal, worlds = nominal_world(SCENE, resting()), draw(perturbations(SCENE, resting()), 16, 0)
    whole, other = worlds.world(5, nominal), worlds.world(6, nominal)
    assert whole.noise.std(axis=0) == pytest.approx([0.2, 0.2], rel=0.1)
    assert np.corrcoef(whole.noise[:, 0], other.noise[:, 0])[0, 1] < 0.2
    assert np.corrcoef(whole.noise.T)[0, 1] < 0.2
    sizes = [item.size for item in worlds.causes[:4]]
    assert whole.parameters - nominal.parameters == pytest.approx(sizes * worlds.points[5, :4])
    assert whole.gain - 1.0 == pytest.approx(0.02 * worlds.points[5, 10:12])
    assert whole.start - nominal.start == pytest.approx(0.01 * worlds.points[5, 4:10])
    assert whole.delay == pytest.approx(0.01 * worlds.points[5, 14])
    assert (
        draw(perturbations(SCENE, resting()), 16, 1).world(5, nominal).noise[0, 0]
        != whole.noise[0, 0]
    )


@pytest.mark.parametrize(
    ("delay", "times", "values"),
    [
        (0.0, [0, 1, 2, 3], [1, 2, 4]),
        (0.25, [0, 0.25, 1, 1.25, 2, 2.25, 3], [1, 1, 1, 2, 2, 4]),
        (1.0, [0, 1, 2, 3], [1, 1, 2]),
        (1.25, [0, 1, 1.25, 2, 2.25, 3], [1, 1, 1, 1, 2]),
        (9.0, [0, 1, 2, 3], [1, 1, 1]),
    ],
)
def test_a_held_input_arrives_later(delay: float, times: list[float], values: list[float]):
    found = WorldInputs(plan([1, 2, 4]), world(delay))
    assert (found.times.tolist(), found.values[:, 0].tolist(), found.linear) == (
        times,
        values,
        False,
    )
    assert found.times[found.rows].tolist() == [0, 1, 2, 3]
    assert [found.begin(step, None)[0] for step in range(len(values))] == values
    assert found.stops == list(range(1, len(times)))


def test_a_line_arrives_later_and_rises_from_then_on():
    found = WorldInputs(plan([1, 2, 4], Hold.LINEAR, 8), world(0.25, gain=2.0))
    assert found.times.tolist() == [0, 0.25, 1, 1.25, 2, 2.25, 3]
    assert found.values[:, 0] == pytest.approx([2, 2, 3.5, 4, 7, 8])
    assert found.slopes[:, 0] == pytest.approx([0, 2, 2, 4, 4, 8])
    assert found.linear


def test_gain_is_of_the_command_and_noise_of_the_actuator():
    found = WorldInputs(plan([1, 2, 4]), world(0.25, gain=3.0, noise=[0.1, 0.2, 0.3]))
    assert found.values[:, 0] == pytest.approx([3.1, 3.1, 3.2, 6.2, 6.3, 12.3])


@pytest.mark.parametrize(
    ("delay", "applied"), [(0.0, [2.0, 3.0, 4.6]), (0.5, [2.0, 2.0, 2.0, 3.0, 3.0, 4.6])]
)
def test_feedback_commands_at_the_nodes_and_is_heard_later(delay: float, applied: list[float]):
    given = plan([1, 2, 4])
    feedback = following(given, 4.6)
    found = WorldInputs(given, world(delay), feedback)
    # The state is one behind the plan's at every node: each command is one more, the last within
    # its bound.
    states = np.interp(found.times[:-1], given.t, given.q[:, 0] - 1.0)
    assert [
        found.begin(step, np.array([state, 0.0]))[0] for step, state in enumerate(states)
    ] == pytest.approx(applied)
    assert (
        WorldInputs(given, replace(world(), start=np.array([-1.0, 0.0])), feedback).begin(0, None)[
            0
        ]
        == 2.0
    ), "at first it sees the start"
    assert (given.u[:, 0] == [1, 2, 4]).all(), "the plan stays what it is"


@pytest.mark.parametrize(
    ("hold", "delay", "values", "slopes"),
    [
        (Hold.ZERO_ORDER, 0.0, [1, 2, 4], [0, 0, 0]),
        (Hold.ZERO_ORDER, 0.25, [1, 1.75, 3.5], [0, 0, 0]),
        (Hold.ZERO_ORDER, 1.25, [1, 1, 1.75], [0, 0, 0]),
        (Hold.LINEAR, 0.0, [1, 2, 4], [1, 2, 4]),
        # The last: a quarter of a step from 3.5 to 4, then to 7: 5.0625 in the mean, at a mean
        # slope of 3.5.
        (Hold.LINEAR, 0.25, [0.90625, 1.65625, 3.3125], [0.75, 1.75, 3.5]),
    ],
)
def test_who_takes_whole_steps_alone_gets_their_means(
    hold: Hold, delay: float, values: list[float], slopes: list[float]
):
    found = WorldInputs(
        plan([1, 2, 4], hold, 8 if hold is Hold.LINEAR else None), replace(world(delay), whole=True)
    )
    assert found.times.tolist() == [0, 1, 2, 3]
    assert found.values[:, 0] == pytest.approx(values)
    assert found.slopes[:, 0] == pytest.approx(slopes)
    assert found.rows.tolist() == [0, 1, 2, 3]
    assert found.stops == [1, 2, 3]


def test_what_happens_within_a_step_is_shown_at_the_ends_of_its_parts_and_stays_what_it_is():
    halves = np.arange(7) / 2
    later = WorldInputs(
        plan([1, 2, 4]), replace(world(0.25, gain=3.0, noise=[0.1, 0.2, 0.3]), longest=0.5)
    )
    assert later.times.tolist() == [0, 0.25, 0.5, 1, 1.25, 1.5, 2, 2.25, 2.5, 3]
    assert later.values[:, 0] == pytest.approx([3.1, 3.1, 3.1, 3.2, 6.2, 6.2, 6.3, 12.3, 12.3])
    assert (later.times[later.rows].tolist(), later.grid.tolist()) == (
        [0, 1, 2, 3],
        halves.tolist(),
    )
    means = WorldInputs(
        plan([1, 2, 4], Hold.LINEAR, 8), replace(world(0.25), whole=True, longest=0.5)
    )
    assert means.times.tolist() == halves.tolist()
    assert means.values[:, 0] == pytest.approx([0.90625, 1.28125, 1.65625, 2.53125, 3.3125, 5.0625])
    assert means.slopes[:, 0] == pytest.approx([0.75, 0.75, 1.75, 1.75, 3.5, 3.5])
    assert (means.rows.tolist(), means.stops) == ([0, 2, 4, 6], [1, 2, 3, 4, 5, 6])
    given = plan([1, 2, 4])
    fed = WorldInputs(given, replace(world(), longest=0.5), following(given, 9.0))
    applied = [fed.begin(step, np.array([-1.0, 0.0]))[0] for step in range(6)]
    assert applied == [2, 2, 4, 4, 7, 7], "it commands at the plan's nodes alone"
    assert WorldInputs(given, replace(world(0.5), longest=0.5)).times.tolist() == halves.tolist(), (
        "what arrives at the end of a part makes no other"
    )
