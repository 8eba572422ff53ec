"""Axes by hand: what they span, and where and how they are labelled."""

import math

import numpy as np
import pytest

from reports.plots import Axis

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("values", "options", "low", "high"),
    [
        ([2.0, 4.0], {}, 1.9, 4.1), ([2.0, 4.0], {"margin": 0.1}, 1.8, 4.2), ([2.0, 4.0], {"margin": 0.0}, 2.0, 4.0),
        ([2.0, 4.0], {"zero": True}, 0.0, 4.2), ([-4.0, -2.0], {"zero": True}, -4.2, 0.0), ([-1.0, 3.0], {"zero": True}, -1.2, 3.2),
        ([3.0], {}, 1.35, 4.65), ([-3.0, -3.0], {}, -4.65, -1.35), ([1.0, 1.0 + 1e-13], {}, 0.45, 1.55), ([-1.0 - 1e-13, -1.0], {}, -1.55, -0.45),
        ([0.0], {}, -0.55, 0.55), ([1e-201], {}, -0.55, 0.55), ([0.0], {"zero": True}, 0.0, 1.05), ([], {"zero": True}, 0.0, 1.05), ([], {}, -0.05, 1.05),
        ([NAN, INF, -INF, 1e201, -1e201, 2.0, 4.0], {}, 1.9, 4.1), ([1e200, -1e200], {"margin": 0.0}, -1e200, 1e200), ([2.0, 4.0, 1e201], {}, 1.9, 4.1), ([2.0, 4.0, -1e201], {}, 1.9, 4.1),
        ([1.0, 10.0, 0.0], {"log": True}, 10**-0.12, 10**1.12), ([1.0, 10.0, 1e201], {"log": True}, 10**-0.12, 10**1.12),
        ([1e-3, 1e1], {"log": True}, 10**-3.2, 10**1.2), ([1e-3, 1e1], {"log": True, "margin": 0.1}, 10**-3.4, 10**1.4),
        ([1.0, 10.0], {"log": True}, 10**-0.12, 10**1.12), ([], {"log": True}, 10**-3.15, 10**0.15),
        ([0.0, -5.0, NAN, INF, 1e201, 1e-201, 1.0, 10.0], {"log": True}, 10**-0.12, 10**1.12),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", [list, np.array])
def test_an_axis_spans_its_values_with_room_at_both_ends(kind, values: list[float], options: dict, low: float, high: float):
    found = Axis.fitted("q", "m", kind(values), **options)
    assert (found.quantity, found.unit, found.log) == ("q", "m", options.get("log", False))
    assert (found.low, found.high) == (pytest.approx(low), pytest.approx(high))


@pytest.mark.parametrize(
    ("values", "exponent"),
    [
        ([0.0, 0.01], 0), ([0.0, 0.0099], -3), ([0.0, 99_999.0], 0), ([0.0, 1e5], 5), ([-3e6, 1.0], 6), ([-0.005, 0.002], -3), ([0.001, 0.005], -3),
        ([-5e-5, -2e-5], -5),
    ],
)  # fmt: skip
def test_labels_of_small_and_large_values_are_divided_by_a_power_of_ten(values: list[float], exponent: int):
    assert Axis.fitted("q", "m", values).exponent == exponent


@pytest.mark.parametrize(
    ("axis", "title"),
    [
        (Axis("force", "N^2", 0.0, 1.0), "force [N²]"), (Axis("force", "N", 0.0, 1.0, False, 3), "force [10³ N]"),
        (Axis("cost", "", 0.0, 1.0, False, -4), "cost [10⁻⁴]"), (Axis("cost", "1", 0.0, 1.0), "cost"),
    ],
)  # fmt: skip
def test_a_title_has_unit_and_power(axis: Axis, title: str):
    assert axis.title == title


@pytest.mark.parametrize(
    ("low", "high", "most", "values"),
    [
        (0.0, 5.0, 6, [0, 1, 2, 3, 4, 5]), (0.0, 7.0, 6, [0, 2, 4, 6]), (0.0, 12.0, 6, [0, 2, 4, 6, 8, 10, 12]), (0.0, 13.0, 6, [0, 2.5, 5, 7.5, 10, 12.5]),
        (0.0, 20.0, 6, [0, 5, 10, 15, 20]), (0.0, 6.0, 6, [0, 1, 2, 3, 4, 5, 6]), (0.0, 6.003, 6, [0, 1, 2, 3, 4, 5, 6]), (0.0, 6.012, 6, [0, 2, 4, 6]),
        (-1.0, 1.0, 6, [-1, -0.5, 0, 0.5, 1]), (-1.0, 1.0, 3, [-1, 0, 1]), (0.3, 0.7, 4, [0.3, 0.4, 0.5, 0.6, 0.7]), (-7.0, -4.5, 6, [-7, -6.5, -6, -5.5, -5, -4.5]),
    ],
)  # fmt: skip
def test_steps_of_a_linear_axis_are_easy_to_add(low: float, high: float, most: int, values: list[float]):
    assert [value for value, _ in Axis("q", "", low, high).ticks(most)] == pytest.approx(values)


def test_labels_of_a_linear_axis():
    assert [words for _, words in Axis("q", "", -2e3, 2e3).ticks(4)] == ["−2000", "−1000", "0", "1000", "2000"]
    assert Axis("q", "", -2e3, 2e3, False, 3).ticks(4) == [(-2000.0, "−2"), (-1000.0, "−1"), (0.0, "0"), (1000.0, "1"), (2000.0, "2")]
    assert [words for _, words in Axis("q", "", 0.0, 0.5).ticks()] == ["0", "0.1", "0.2", "0.3", "0.4", "0.5"]


@pytest.mark.parametrize(
    ("low", "high", "most", "ticks"),
    [
        (1e-3, 1e3, 7, {1e-3: "0.001", 1e-2: "0.01", 1e-1: "0.1", 1.0: "1", 1e1: "10", 1e2: "100", 1e3: "1000"}),
        (1e-3, 1e3, 6, {1e-3: "0.001", 1e-1: "0.1", 1e1: "10", 1e3: "1000"}),
        (1e-3, 1e3, 3, {1e-3: "0.001", 1.0: "1", 1e3: "1000"}),
        (1e-4, 1e2, 6, {1e-4: "10⁻⁴", 1e-2: "10⁻²", 1.0: "1", 1e2: "10²"}),
        (1e-3, 1e4, 6, {1e-3: "10⁻³", 1e-1: "10⁻¹", 1e1: "10", 1e3: "10³"}),
        (1e-2, 1.0, 6, {1e-2: "0.01", 1e-1: "0.1", 1.0: "1"}),
        (1.1e-2, 1.0, 6, {0.02: "0.02", 0.03: "0.03", 0.05: "0.05", 0.1: "0.1", 0.2: "0.2", 0.3: "0.3", 0.5: "0.5", 1.0: "1"}),
        (1.1e-2, 1.0, 4, {0.02: "0.02", 0.05: "0.05", 0.2: "0.2", 0.5: "0.5"}),
        (0.25, 45.0, 6, {0.3: "0.3", 0.5: "0.5", 1.0: "1", 2.0: "2", 3.0: "3", 5.0: "5", 10.0: "10", 20.0: "20", 30.0: "30"}),
        (1.5, 6.0, 6, {2.0: "2", 3.0: "3", 5.0: "5"}),
        (1.5, 3.5, 6, {2.0: "2", 3.0: "3"}),
        (2.9, 3.1, 6, {2.9: "2.9", 2.95: "2.95", 3.0: "3", 3.05: "3.05", 3.1: "3.1"}),
    ],
)  # fmt: skip
def test_ticks_of_a_logarithmic_axis_are_decades_or_ones_twos_threes_and_fives(low: float, high: float, most: int, ticks: dict[float, str]):
    found = Axis("q", "", low, high, log=True).ticks(most)
    assert [value for value, _ in found] == pytest.approx(list(ticks))
    assert [words for _, words in found] == list(ticks.values())
