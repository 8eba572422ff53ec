"""The numbers of a plot as its page holds them: read back here by the format as it is written down."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.plots.axis import Axis
from reports.plots.packed import packed
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
