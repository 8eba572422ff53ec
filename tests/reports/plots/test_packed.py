"""The numbers of a plot as its page holds them: read back here by the format as it is written down."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.plots.axis import Axis
from reports.plots.series import packed


def _unpacked(text: str, x: Axis, y: Axis) -> list[tuple[np.ndarray, np.ndarray]]:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    flat = [int(value) for value in np.ascontiguousarray(planes.reshape(8, -1).T).view("<u8").ravel()]
    signed = [-(value + 1) // 2 if value % 2 else value // 2 for value in flat]
    heads = np.array(signed[1 : 1 + 4 * signed[0]]).reshape(-1, 4)
    at, series, xs = 1 + 4 * signed[0], [], np.zeros(0)
    for x_count, x_exponent, y_count, y_exponent in heads.tolist():
        columns = []
        for count, exponent, axis in ((x_count, x_exponent, x), (y_count, y_exponent, y)):
            values = np.cumsum(np.cumsum(np.array(signed[at : at + count], float))) * 10.0**exponent
            columns.append(10.0**values if axis.log else values)
            at += count
        xs = columns[0] if x_count else xs
        series.append((xs, columns[1]))
    assert at == len(signed)
    return series


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60))
def test_values_come_back_within_a_ten_thousandth_of_the_axis(values):
    ys, xs = np.array(values), np.linspace(0.0, 0.01 * (len(values) - 1), len(values))
    x, y = Axis.fitted("time", "s", xs), Axis.fitted("q", "m", ys)
    ((found_x, found_y),) = _unpacked(packed([(xs, ys)], x, y), x, y)
    assert found_x == pytest.approx(xs, abs=0.5e-6 * (x.high - x.low) * 1.01)
    assert found_y == pytest.approx(ys, abs=0.5e-4 * (y.high - y.low) * 1.01)


def test_a_logarithmic_axis_keeps_five_digits_of_small_values_too():
    ys = np.array([1e-9, 3.3e-7, 2.5, 4e4])
    x, y = Axis("n", "", 0.0, 3.0), Axis.fitted("error", "m", ys, log=True)
    ((_, found),) = _unpacked(packed([(np.arange(4.0), ys)], x, y), x, y)
    assert found == pytest.approx(ys, rel=1.2e-5)


def test_times_that_two_series_share_are_held_once():
    x, y = Axis("t", "s", 0.0, 1.0), Axis("q", "m", 0.0, 1.0)
    rng = np.random.default_rng(0)
    t, other = np.sort(rng.random(500)), np.sort(rng.random(500))
    flat = np.zeros(500)
    alike = packed([(t, flat), (t, flat)], x, y)
    assert len(alike) < 0.6 * len(packed([(t, flat), (other, flat)], x, y))
    first, second = _unpacked(alike, x, y)
    assert np.array_equal(first[0], second[0])
