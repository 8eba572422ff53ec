"""The equations of the score against numbers worked out by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene.goal import distance
from validate.judge.replay.result import Difference, Event
from validate.judge.score import equations as eq
from validate.judge.score import measures
from validate.judge.score.verdict import Unmeasured


def test_rate_misfit_smooth_motion_next_to_nothing_and_alternating_all():
    """Velocities of +-0.5 m/s in turn on a motion of 1 m/s^2."""
    t = np.linspace(0.0, 1.0, 101)
    q, v = t[:, None] ** 2 / 2.0, t[:, None].copy()
    assert eq.rate_misfit(t, q, v, 0.01).max() == pytest.approx(0.0, abs=1e-12)
    v[:, 0] += 0.5 * (-1.0) ** np.arange(101)
    assert eq.rate_misfit(t, q, v, 0.01) == pytest.approx(np.full((99, 1), 0.495), abs=1e-9)
    assert eq.rate_misfit(t, q, v, 0.1).min() > 0.4


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
        assert found.max(axis=0) == pytest.approx([expected, 0.25])


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
        scene=scene,
        kernel=load_kernel(scene),
        error=error,
        replay=SimpleNamespace(events=told, **replay),
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


def test_depth_measure_is_that_of_the_deepest_contact(monkeypatch: pytest.MonkeyPatch):
    found = np.array([0.1, 0.3]), np.array([0.0, 0.02])
    monkeypatch.setattr(measures, "deepest", lambda case: found)
    assert measures.MEASURES["depth"](contacts_of_carts([])) == pytest.approx((0.3, 0.01 + 0.02))
