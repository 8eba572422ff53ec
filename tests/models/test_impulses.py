"""Impulses that only a plan or only its motion has."""

import numpy as np
import pytest

from models.scene.impulses import (
    common_impulse,
    excess_impulse,
    force_window,
    impulse_yardstick,
)


def window(lam: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    return force_window(lam, np.arange(steps), steps)


def test_force_window_reaches_one_step_to_either_side():
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


def test_excess_impulse_contact_one_step_early_zero():
    h, replayed = np.full(10, 0.1), np.repeat([0.0, 6.0], [5, 6])[:, None]
    least, largest = window(replayed, 10)
    for shift in (-1, 0, 1):
        planned = np.repeat([0.0, 6.0], [5 + shift, 5 - shift])[:, None]
        assert excess_impulse(planned, largest, h) == 0.0
        assert excess_impulse(least, planned, h) == 0.0
    sooner = np.repeat([0.0, 6.0], [2, 8])[:, None]
    assert excess_impulse(sooner, largest, h) == pytest.approx(
        0.1 * 6.0
    )  # step 2; step 3 reaches the force at the end of step 4
    later = np.repeat([0.0, 6.0], [9, 1])[:, None]
    assert excess_impulse(least, later, h) == pytest.approx(0.1 * 6.0 * 3)


@pytest.mark.parametrize("replayed", [0.0, 3.0, 6.0])
def test_excess_impulse_alternating_forces_counted(replayed: float):
    """The plan alternates between 0 and 6 N, the motion has a steady force."""
    h, planned = np.full(10, 0.1), np.tile([6.0, 0.0], 5)[:, None]
    least, largest = window(np.full((11, 1), replayed), 10)
    assert excess_impulse(planned, largest, h) == pytest.approx(0.1 * 5 * (6.0 - replayed))
    assert excess_impulse(least, planned, h) == pytest.approx(0.1 * 5 * replayed)


def test_force_window_pieces_of_unequal_number_include_both_ends():
    """Step 0 has three pieces, steps 1 and 2 have one; a mean beyond the rows counts."""
    lam = np.array([[1.0], [9.0], [2.0], [3.0], [4.0], [5.0]])
    step_of = np.array([0, 0, 0, 1, 2])
    least, most = force_window(lam, step_of, 3)
    assert (least.ravel().tolist(), most.ravel().tolist()) == ([1, 1, 3], [9, 9, 5])
    least, most = force_window(lam, step_of, 3, np.array([[5.0], [0.5], [7.0]]))
    assert (least.ravel().tolist(), most.ravel().tolist()) == ([0.5] * 3, [9, 9, 7])
    empty = force_window(lam[:, :0], step_of, 3)
    assert [part.shape for part in empty] == [(3, 0), (3, 0)]


def test_impulse_yardstick_is_the_common_impulse_or_a_fiftieth_of_the_plan():
    h = np.full(4, 0.5)
    lam, most = np.array([[-1.0], [2.0], [3.0], [0.0]]), np.array([[2.0], [1.0], [9.0], [9.0]])
    common = common_impulse(lam, most, h)
    assert common == pytest.approx(0.5 * (1.0 + 1.0 + 3.0))
    assert impulse_yardstick(common, 10.0, 2.0) == common
    assert impulse_yardstick(common, 100.0, 2.0) == pytest.approx(4.0)
