"""The numbers of a plot as its page holds them: read back here by the format as it is written down."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.plots import Axis, packed
from tests.reports.drawn import unpacked


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60))
def test_values_come_back_within_a_ten_thousandth_of_the_axis(values):
    ys, xs = np.array(values), np.linspace(0.0, 0.01 * (len(values) - 1), len(values))
    x, y = Axis.fitted("time", "s", xs), Axis.fitted("q", "m", ys)
    ((found_x, found_y),) = unpacked(packed([(xs, ys)], x, y), x, y)
    assert found_x == pytest.approx(xs, abs=0.5e-6 * (x.high - x.low) * 1.01)
    assert found_y == pytest.approx(ys, abs=0.5e-4 * (y.high - y.low) * 1.01)


def test_a_logarithmic_axis_keeps_five_digits_of_small_values_too():
    ys = np.array([1e-9, 3.3e-7, 2.5, 4e4])
    x, y = Axis("n", "", 0.0, 3.0), Axis.fitted("error", "m", ys, log=True)
    ((_, found),) = unpacked(packed([(np.arange(4.0), ys)], x, y), x, y)
    assert found == pytest.approx(ys, rel=1.2e-5)


def test_times_that_two_series_share_are_held_once():
    x, y = Axis("t", "s", 0.0, 1.0), Axis("q", "m", 0.0, 1.0)
    rng = np.random.default_rng(0)
    t, other = np.sort(rng.random(500)), np.sort(rng.random(500))
    flat = np.zeros(500)
    alike = packed([(t, flat), (t, flat)], x, y)
    assert len(alike) < 0.6 * len(packed([(t, flat), (other, flat)], x, y))
    first, second = unpacked(alike, x, y)
    assert np.array_equal(first[0], second[0])


def heads(text: str) -> list[int]:
    """The first whole numbers: how many series there are, then of each count and exponent of x and of y."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    flat = [int(value) for value in np.ascontiguousarray(planes.reshape(8, -1).T).view("<u8").ravel()]
    signed = [-(value + 1) // 2 if value % 2 else value // 2 for value in flat]
    return signed[: 1 + 4 * signed[0]]


@pytest.mark.parametrize(
    ("x", "y", "values", "found"),
    [
        (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (0.5, 0.5), [-6, -4]), (Axis("t", "", 1.0, 501.0), Axis("q", "", -300.0, 200.0), (2.0, 2.0), [-4, -2]),
        (Axis("t", "", 0.0, 0.05), Axis("q", "", 0.0, 0.9), (0.01, 0.5), [-8, -5]), (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (2e12, -2e12), [-1, -1]),
        (Axis("t", "", 1.0, 10.0, log=True), Axis("q", "", 0.1, 10.0, log=True), (2.0, 3.0), [-5, -5]), (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (1e9, 1e11), [-5, -3]),
    ],
)  # fmt: skip
def test_grains_are_a_share_of_the_axis_but_no_finer_than_what_is_exact(x: Axis, y: Axis, values: tuple[float, float], found: list[int]):
    """A millionth of x, a ten thousandth of y; fourteen digits; five of a decade."""
    text = packed([(np.array([values[0]]), np.array([values[1]]))], x, y)
    assert heads(text) == [1, 1, found[0], 1, found[1]]


def test_what_is_not_positive_is_far_below_a_logarithmic_axis():
    x, y = Axis("t", "", 0.0, 1.0), Axis("q", "", 0.1, 10.0, log=True)
    ((_, found),) = unpacked(packed([(np.arange(3.0), np.array([0.0, -1.0, 1.0]))], x, y), x, y)
    assert found == pytest.approx([1e-200, 1e-200, 1.0])


def test_times_are_held_again_only_where_they_differ():
    axis = Axis("t", "", 0.0, 1.0)
    one, other = np.array([0.0, 0.5]), np.array([0.0, 0.25])
    counts = heads(packed([(one, one), (one, other), (other, one), (other, other)], axis, axis))
    assert counts == [4, 2, -6, 2, -4, 0, -6, 2, -4, 2, -6, 2, -4, 0, -6, 2, -4]
