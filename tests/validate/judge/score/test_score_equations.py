"""The equations of the score against numbers worked out by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.scene.goal import distance
from validate.judge.replay.result import Difference, Event
from validate.judge.score import equations as eq
from validate.judge.score import measures
from validate.judge.score.equations import half_unit
from validate.judge.score.own_steps import force_window
from validate.judge.score.verdict import Unmeasured

# A contact that closes within the second of three steps of 0.1 s and is deepest at the end: the
# law's force at the four nodes.
LAW = np.array([[0.0], [0.0], [6.0], [10.0]])
H = np.full(3, 0.1)


# What it is within each step: nothing but a bounce between the first two nodes, which they do not
# see.
LEAST = np.minimum(LAW[:-1], LAW[1:])
MOST = np.array([[3.0], [6.0], [11.0]])


@pytest.mark.parametrize(
    "forces",
    [LAW[:-1], LAW[1:], (LAW[:-1] + LAW[1:]) / 2.0, MOST],
    ids=["start", "end", "mean", "between"],
)
def test_forces_of_the_start_the_end_or_a_mean_of_a_step_are_those_of_contact(forces: np.ndarray):
    assert eq.contact_law_error(forces, LAW, LEAST, MOST, H) == 0.0


def test_forces_of_another_motion_are_counted_to_the_newton_second():
    invented = LAW[:-1] + np.array([[5.0], [0.0], [0.0]])
    assert eq.contact_law_error(invented, LAW, LEAST, MOST, H) == pytest.approx(0.1 * (5.0 - 3.0))
    far = np.vstack([np.zeros((5, 1)), LAW])  # five steps before anything touches
    least, most = np.minimum(far[:-1], far[1:]), np.maximum(far[:-1], far[1:])
    planned = np.zeros((8, 1))
    planned[1:3] = 4.0
    planned[6:] = far[6:-1]
    assert eq.contact_law_error(planned, far, least, most, np.full(8, 0.1)) == pytest.approx(
        0.1 * 2 * 4.0
    )
    mirrored = -LAW[1:]
    assert eq.contact_law_error(mirrored, LAW, LEAST, MOST, H) == pytest.approx(
        0.1 * (0.0 + 6.0 + (10.0 + 6.0))
    )


def window(lam: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a replay of one row a node."""
    return force_window(lam, np.arange(steps), steps)


def test_a_window_reaches_one_step_to_either_side():
    lam = np.array([0.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0])[:, None]
    least, largest = window(lam, 7)
    assert not least.any()
    assert largest[:, 0].tolist() == [
        0.0,
        8.0,
        8.0,
        8.0,
        8.0,
        0.0,
        0.0,
    ]  # the node ends step 2 and begins step 3


def test_a_contact_that_closes_a_step_sooner_is_neither_ghost_nor_missed():
    h, replayed = np.full(10, 0.1), np.repeat([0.0, 6.0], [5, 6])[:, None]
    least, largest = window(replayed, 10)
    for shift in (-1, 0, 1):
        planned = np.repeat([0.0, 6.0], [5 + shift, 5 - shift])[:, None]
        assert eq.excess_impulse(planned, largest, h) == 0.0
        assert eq.excess_impulse(least, planned, h) == 0.0
    sooner = np.repeat([0.0, 6.0], [2, 8])[:, None]
    assert eq.excess_impulse(sooner, largest, h) == pytest.approx(
        0.1 * 6.0
    )  # step 2; step 3 reaches the force at the end of step 4
    later = np.repeat([0.0, 6.0], [9, 1])[:, None]
    assert eq.excess_impulse(least, later, h) == pytest.approx(0.1 * 6.0 * 3)


@pytest.mark.parametrize("replayed", [0.0, 3.0, 6.0])
def test_alternating_forces_are_not_excused(replayed: float):
    """A plan of 0 and 6 N by turns, where the replay has a steady force: no window of steps makes the one the other."""
    h, planned = np.full(10, 0.1), np.tile([6.0, 0.0], 5)[:, None]
    least, largest = window(np.full((11, 1), replayed), 10)
    assert eq.excess_impulse(planned, largest, h) == pytest.approx(0.1 * 5 * (6.0 - replayed))
    assert eq.excess_impulse(least, planned, h) == pytest.approx(0.1 * 5 * replayed)


MOTION = np.random.default_rng(4).normal(size=(50, 3)) * np.array([1.0, 3.0, 20.0])


@pytest.mark.parametrize("decimals", [3, 4, 6])
def test_printed_decimals_are_found(decimals: int):
    printed = np.array([float(f"{value:.{decimals}f}") for value in MOTION.ravel()]).reshape(
        MOTION.shape
    )
    assert half_unit(printed, most=1e4) == pytest.approx(0.5 * 10.0**-decimals)
    assert np.abs(printed - MOTION).max() <= half_unit(printed, most=1e4)


@pytest.mark.parametrize("digits", [4, 7])
def test_printed_digits_are_found(digits: int):
    """%.4g of a motion that begins small: so many decimals that they are none that anybody chose.

    The largest number has the coarsest unit, and counts.
    """
    motion = np.vstack([1e-5 * MOTION[:1], MOTION])
    printed = np.array([float(f"{value:.{digits}g}") for value in motion.ravel()]).reshape(
        motion.shape
    )
    assert half_unit(printed, most=1e4) == pytest.approx(
        0.5 * 10.0 ** (2 - digits)
    )  # the largest is some ten
    assert np.abs(printed - motion).max() <= half_unit(printed, most=1e4)


def test_few_decimals_are_decimals_though_the_largest_number_is_round():
    """9.1234 beside 10.5: as five digits their unit would be 1e-3."""
    assert half_unit(np.array([9.1234, 10.5, -0.0321]), most=10.0) == pytest.approx(5e-5)


def test_all_digits_excuse_nothing_and_neither_do_round_numbers():
    assert half_unit(MOTION, most=1.0) == 0.0
    assert half_unit(np.zeros((5, 2)), most=1.0) == 0.0
    assert (
        half_unit(np.round(MOTION), most=1.0) == 0.0
    )  # whole numbers are taken as they stand: half a metre is no rounding
    assert half_unit(np.round(MOTION), most=1000.0) == pytest.approx(
        0.5
    )  # but it is where kilometres count
    assert half_unit(np.round(MOTION), most=999.0) == 0.0
    assert half_unit(0.01 * np.arange(500.0)[:, None] ** 2 / 3.0, most=1.0) == 0.0


@pytest.mark.parametrize("place", range(5))
def test_the_energy_turned_over_is_the_largest_of_five(place: int):
    """Of the potential only its range counts, of works their size, of the others what is there."""
    small = [np.array([0.0, 0.1, 0.05])] * 5
    large = [
        np.array([1.0, 2.0, 0.0]), np.array([10.0, 12.0, 11.0]), np.array([0.5, 2.0, 2.0]),
        np.array([0.0, -2.0, 1.0]), np.array([0.0, -2.0, 1.0]),
    ]  # fmt: skip
    parts = [large[index] if index == place else small[index] for index in range(5)]
    assert eq.energy_turnover(*parts) == 2.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_friction_dissipates_all_of_its_range_or_sticks(side: float):
    """Two frictions over three steps; mu N between 1 and 2 N.

    1 N against the slip of 0.5 m/s is within, 0.5 N too little, 3 N too much, 0.25 N along too
    little by 1.25.
    """
    least, most = np.full((3, 2), 1.0), np.full((3, 2), 2.0)
    slip = side * np.array([[0.5, 0.0], [-0.5, 2.0], [0.5, 0.25]])
    second = [5.0, -1.25, -3.0]
    for first, expected in (
        ((-1.0, 1.0, -1.0), 0.0),
        ((-0.5, 1.0, -1.5), 0.25),
        ((-3.0, 1.0, -1.0), 0.5),
        ((0.25, 1.0, -1.0), 0.625),
    ):
        found = eq.friction_dissipation_error(
            side * np.column_stack([first, second]), least, most, slip
        )
        assert found == pytest.approx([expected, 0.25])


def test_what_is_free_in_the_goal_is_no_distance_and_the_largest_difference_says_where():
    assert distance(np.array([3.0, 7.0, -1.0]), np.array([0.0, np.nan, 3.0])) == pytest.approx(5.0)
    one = np.array([[0.0, 1.0], [2.0, 1.0], [0.0, 0.0]])
    assert eq.largest_difference(one, np.array([[0.0, 0.5], [2.0, 4.0], [1.0, 0.0]])) == (3.0, 1)


# Closed forms


def contacts_of_carts(events: list[tuple[float, str, bool]], **rows: np.ndarray) -> Any:
    """Three carts, whose gaps are q2 - q1 - 0.5 and q3 - q2 - 0.5, at six rows a tenth of a second apart."""
    scene = load_scene("three_cart")
    v = np.array([[7.0, 1.0, 2.0]] * 6)
    v[2], v[4] = (7.0, 1.0, -1.0), (7.0, -0.5, 1.0)
    replay = {"t": 0.1 * np.arange(6), "q": np.zeros((6, 3)), "v": v} | rows
    told = tuple(
        Event(time=time, contact=contact, closes=closes) for time, contact, closes in events
    )
    error = Difference(position=1.0, state=0.02, gap=0.01)
    return SimpleNamespace(
        scene=scene, equations=scene, error=error, replay=SimpleNamespace(events=told, **replay)
    )


EVENTS = [
    (0.1, "right", False), (0.2, "right", True), (0.25, "left", True), (0.3, "left", False),
    (0.4, "right", False), (0.5, "right", True),
]  # fmt: skip


def test_the_first_contact_is_measured_from_where_it_closes_to_where_the_same_one_opens():
    case = contacts_of_carts(EVENTS)
    measured = {
        name: measures.MEASURES[name](case)
        for name in ("closing time", "contact time", "restitution")
    }
    # Its gap closes at 2 m/s and opens at 1.5 m/s.
    assert measured["closing time"] == pytest.approx((0.2, 0.01 / 2))
    assert measured["contact time"] == pytest.approx((0.2, 0.01 / 2 + 0.01 / 1.5))
    assert measured["restitution"] == pytest.approx((0.75, 2 * 0.02 / 2))
    with pytest.raises(Unmeasured, match="no contact closes"):
        measures.MEASURES["closing time"](contacts_of_carts(EVENTS[:1]))
    with pytest.raises(Unmeasured, match="contact right does not open again"):
        measures.MEASURES["contact time"](contacts_of_carts(EVENTS[:4]))


@pytest.mark.parametrize("contact", [0, 1])
@pytest.mark.parametrize(
    "deepest",
    [0.02, 0.17, 0.28, 0.485],
    ids=["at the first row", "before a row", "behind a row", "at the last row"],
)
def test_a_depth_is_found_between_the_rows(contact: int, deepest: float):
    """A parabola, 0.1 m deep: a cubic with the same ends is the same."""
    t = 0.1 * np.arange(6)
    gap, v = np.full((6, 2), 0.3), np.zeros((6, 3))
    gap[:, contact] = 8.0 * (t - deepest) ** 2 - 0.1
    v[:, contact + 1] = 16.0 * (t - deepest)
    if contact == 0:
        v[:, 2] = v[:, 1]
    found = measures.MEASURES["depth"](contacts_of_carts([], gap=gap, v=v))
    assert found == pytest.approx((0.1, 0.01), abs=1e-6)
    open_gap = measures.MEASURES["depth"](contacts_of_carts([], gap=gap + 1.0, v=v))
    assert open_gap[0] == 0.0


def test_an_answer_is_off_by_so_many_of_its_own_tolerances():
    answers = [("closing time", 0.23, 0.01), ("restitution", 0.7, 0.1), ("", 5.0, 1.0)]
    case = contacts_of_carts(EVENTS)
    case.scene = SimpleNamespace(
        contacts=case.scene.contacts,
        answers=[
            SimpleNamespace(measure=measure, value=value, tolerance=tolerance)
            for measure, value, tolerance in answers
        ],
    )
    assert measures.answer_error(case) == pytest.approx((3.0, 0.5))
    case.scene.answers[1].tolerance = 0.005
    assert measures.answer_error(case) == pytest.approx((10.0, 4.0))


def test_a_depth_is_looked_for_within_the_replay_alone():
    """It ends while it still falls: what comes after is nobody's."""
    t = 0.1 * np.arange(6)
    gap, v = np.full((6, 2), 0.3), np.zeros((6, 3))
    gap[:, 1], v[:, 2] = 0.4 - t, -1.0
    assert measures.MEASURES["depth"](contacts_of_carts([], gap=gap, v=v)) == pytest.approx(
        (0.1, 0.01), abs=1e-12
    )
    gap[:, 1], v[:, 2] = t - 0.1, 1.0
    assert measures.MEASURES["depth"](contacts_of_carts([], gap=gap, v=v)) == pytest.approx(
        (0.1, 0.01), abs=1e-12
    )
