"""Plots by hand: what axes span and how they are labelled, what is drawn where, which points of a line are left out, numbers packed into a page."""

import base64
import html
import json
import math
import re
import zlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wording import unsaid

from reports.plots import Axis, Plot, packed, seen
from tests.reports.drawn import drawn, unpacked

NAN = math.nan
INF = math.inf


@pytest.mark.parametrize(
    ("values", "options", "low", "high"),
    [
        ([2.0, 4.0], {}, 1.9, 4.1), ([2.0, 4.0], {"margin": 0.1}, 1.8, 4.2),
        ([2.0, 4.0], {"margin": 0.0}, 2.0, 4.0),
        ([2.0, 4.0], {"zero": True}, 0.0, 4.2), ([-4.0, -2.0], {"zero": True}, -4.2, 0.0),
        ([-1.0, 3.0], {"zero": True}, -1.2, 3.2),
        ([3.0], {}, 1.35, 4.65), ([-3.0, -3.0], {}, -4.65, -1.35),
        ([1.0, 1.0 + 1e-13], {}, 0.45, 1.55), ([-1.0 - 1e-13, -1.0], {}, -1.55, -0.45),
        ([0.0], {}, -0.55, 0.55), ([1e-201], {}, -0.55, 0.55), ([0.0], {"zero": True}, 0.0, 1.05),
        ([], {"zero": True}, 0.0, 1.05), ([], {}, -0.05, 1.05),
        ([NAN, INF, -INF, 1e201, -1e201, 2.0, 4.0], {}, 1.9, 4.1),
        ([1e200, -1e200], {"margin": 0.0}, -1e200, 1e200), ([2.0, 4.0, 1e201], {}, 1.9, 4.1),
        ([2.0, 4.0, -1e201], {}, 1.9, 4.1),
        ([1.0, 10.0, 0.0], {"log": True}, 10**-0.12, 10**1.12),
        ([1.0, 10.0, 1e201], {"log": True}, 10**-0.12, 10**1.12),
        ([1e-3, 1e1], {"log": True}, 10**-3.2, 10**1.2),
        ([1e-3, 1e1], {"log": True, "margin": 0.1}, 10**-3.4, 10**1.4),
        ([1.0, 10.0], {"log": True}, 10**-0.12, 10**1.12), ([], {"log": True}, 10**-3.15, 10**0.15),
        ([0.0, -5.0, NAN, INF, 1e201, 1e-201, 1.0, 10.0], {"log": True}, 10**-0.12, 10**1.12),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", [list, np.array])
def test_an_axis_spans_its_values_with_room_at_both_ends(
    kind, values: list[float], options: dict, low: float, high: float
):
    found = Axis.fitted("q", "m", kind(values), **options)
    assert (found.quantity, found.unit, found.log) == ("q", "m", options.get("log", False))
    assert (found.low, found.high) == (pytest.approx(low), pytest.approx(high))


@pytest.mark.parametrize(
    ("values", "exponent"),
    [
        ([0.0, 0.01], 0), ([0.0, 0.0099], -3), ([0.0, 99_999.0], 0), ([0.0, 1e5], 5),
        ([-3e6, 1.0], 6), ([-0.005, 0.002], -3), ([0.001, 0.005], -3),
        ([-5e-5, -2e-5], -5),
    ],
)  # fmt: skip
def test_labels_of_small_and_large_values_are_divided_by_a_power_of_ten(
    values: list[float], exponent: int
):
    assert Axis.fitted("q", "m", values).exponent == exponent


@pytest.mark.parametrize(
    ("axis", "title"),
    [
        (Axis("force", "N^2", 0.0, 1.0), "force [N²]"),
        (Axis("force", "N", 0.0, 1.0, False, 3), "force [10³ N]"),
        (Axis("cost", "", 0.0, 1.0, False, -4), "cost [10⁻⁴]"),
        (Axis("cost", "1", 0.0, 1.0), "cost"),
    ],
)  # fmt: skip
def test_a_title_has_unit_and_power(axis: Axis, title: str):
    assert axis.title == title


@pytest.mark.parametrize(
    ("low", "high", "most", "values"),
    [
        (0.0, 5.0, 6, [0, 1, 2, 3, 4, 5]), (0.0, 7.0, 6, [0, 2, 4, 6]),
        (0.0, 12.0, 6, [0, 2, 4, 6, 8, 10, 12]), (0.0, 13.0, 6, [0, 2.5, 5, 7.5, 10, 12.5]),
        (0.0, 20.0, 6, [0, 5, 10, 15, 20]), (0.0, 6.0, 6, [0, 1, 2, 3, 4, 5, 6]),
        (0.0, 6.003, 6, [0, 1, 2, 3, 4, 5, 6]), (0.0, 6.012, 6, [0, 2, 4, 6]),
        (-1.0, 1.0, 6, [-1, -0.5, 0, 0.5, 1]), (-1.0, 1.0, 3, [-1, 0, 1]),
        (0.3, 0.7, 4, [0.3, 0.4, 0.5, 0.6, 0.7]), (-7.0, -4.5, 6, [-7, -6.5, -6, -5.5, -5, -4.5]),
    ],
)  # fmt: skip
def test_steps_of_a_linear_axis_are_easy_to_add(
    low: float, high: float, most: int, values: list[float]
):
    assert [value for value, _ in Axis("q", "", low, high).ticks(most)] == pytest.approx(values)


def test_labels_of_a_linear_axis():
    assert [words for _, words in Axis("q", "", -2e3, 2e3).ticks(4)] == [
        "−2000",
        "−1000",
        "0",
        "1000",
        "2000",
    ]
    assert Axis("q", "", -2e3, 2e3, False, 3).ticks(4) == [
        (-2000.0, "−2"),
        (-1000.0, "−1"),
        (0.0, "0"),
        (1000.0, "1"),
        (2000.0, "2"),
    ]
    assert [words for _, words in Axis("q", "", 0.0, 0.5).ticks()] == [
        "0",
        "0.1",
        "0.2",
        "0.3",
        "0.4",
        "0.5",
    ]


@pytest.mark.parametrize(
    ("low", "high", "most", "ticks"),
    [
        (1e-3, 1e3, 7,
         {1e-3: "0.001", 1e-2: "0.01", 1e-1: "0.1", 1.0: "1", 1e1: "10", 1e2: "100", 1e3: "1000"}),
        (1e-3, 1e3, 6, {1e-3: "0.001", 1e-1: "0.1", 1e1: "10", 1e3: "1000"}),
        (1e-3, 1e3, 3, {1e-3: "0.001", 1.0: "1", 1e3: "1000"}),
        (1e-4, 1e2, 6, {1e-4: "10⁻⁴", 1e-2: "10⁻²", 1.0: "1", 1e2: "10²"}),
        (1e-3, 1e4, 6, {1e-3: "10⁻³", 1e-1: "10⁻¹", 1e1: "10", 1e3: "10³"}),
        (1e-2, 1.0, 6, {1e-2: "0.01", 1e-1: "0.1", 1.0: "1"}),
        (1.1e-2, 1.0, 6,
         {0.02: "0.02", 0.03: "0.03", 0.05: "0.05", 0.1: "0.1", 0.2: "0.2", 0.3: "0.3", 0.5: "0.5",
          1.0: "1"}),
        (1.1e-2, 1.0, 4, {0.02: "0.02", 0.05: "0.05", 0.2: "0.2", 0.5: "0.5"}),
        (0.25, 45.0, 6,
         {0.3: "0.3", 0.5: "0.5", 1.0: "1", 2.0: "2", 3.0: "3", 5.0: "5", 10.0: "10", 20.0: "20",
          30.0: "30"}),
        (1.5, 6.0, 6, {2.0: "2", 3.0: "3", 5.0: "5"}),
        (1.5, 3.5, 6, {2.0: "2", 3.0: "3"}),
        (2.9, 3.1, 6, {2.9: "2.9", 2.95: "2.95", 3.0: "3", 3.05: "3.05", 3.1: "3.1"}),
    ],
)  # fmt: skip
def test_ticks_of_a_logarithmic_axis_are_decades_or_ones_twos_threes_and_fives(
    low: float, high: float, most: int, ticks: dict[float, str]
):
    found = Axis("q", "", low, high, log=True).ticks(most)
    assert [value for value, _ in found] == pytest.approx(list(ticks))
    assert [words for _, words in found] == list(ticks.values())


def plot(**changes) -> Plot:
    return Plot("a plot", Axis("time", "s", 0.0, 4.0), Axis("force", "N^2", -1.0, 1.0), **changes)


def test_grid_ticks_and_titles_stand_where_they_belong():
    svg = str(plot().markup())
    assert not unsaid(
        svg,
        '<path class="grid x" d="M54,26V202M147,26V202M240,26V202M333,26V202M426,26V202"/>',
        '<path class="grid" d="M54,202H426M54,158H426M54,70H426M54,26H426"/><path class="grid zero" d="M54,114H426"/>',
        '<g class="tick x"><text x="54" y="217">0</text><text x="147" y="217">1</text><text x="240" y="217">2</text>',
        '<text x="426" y="217">4</text></g><g class="tick"><text x="48" y="206">−1</text><text x="48" y="162">−0.5</text><text x="48" y="118">0</text>',
        '<path class="frame" d="M54,26V202H426"/>',
        '<text class="axis x" x="426" y="234">time [s]</text><text class="axis" x="2" y="12">force [N²]</text>',
        '<svg class="plot" viewBox="0 0 440 240"',
        ' aria-hidden="true">',
    )
    assert "aria-hidden" not in str(plot().markup(hidden=False))
    # 660 and 330 pixels, less the margins, have room for 9 and 8 labels.
    wide = str(plot(width=660, height=330).markup())
    assert re.findall(r'<text x="([\d.]+)" y="307">', wide) == [
        "54",
        "128",
        "202",
        "276",
        "350",
        "424",
        "498",
        "572",
        "646",
    ]
    assert re.findall(r'<text x="48" y="([\d.]+)">', wide) == [
        "296",
        "262.8",
        "229.5",
        "196.2",
        "163",
        "129.8",
        "96.5",
        "63.2",
        "30",
    ]
    small = str(plot(width=120, height=80).markup())
    assert (small.count(' y="57">'), small.count('<text x="48"')) == (3, 3), (
        "three labels at least are asked for"
    )


def test_labels_are_as_many_as_have_room_inside_the_frame():
    """Of 400 by 240 pixels 332 and 176 are inside: room for five labels each, which a range of three tells from six."""
    one = Plot("a plot", Axis("time", "s", 0.0, 3.0), Axis("force", "N", 0.0, 3.0), width=400)
    below, left = re.findall(r'<g class="tick[^"]*">(.*?)</g>', str(one.markup()))
    assert [re.findall(r">([\d.]+)<", ticks) for ticks in (below, left)] == [
        ["0", "1", "2", "3"]
    ] * 2


def test_the_script_is_told_the_axes_and_their_pixels():
    mixed = Plot(
        "a plot", Axis("it's <q>", "m^2", 0.5, 1234567.89), Axis("error", "", 1e-3, 10.0, log=True)
    )
    found = re.search(r"data-axes='([^']*)'", str(mixed.markup()))
    assert json.loads(html.unescape(found[1])) == {
        "x": [0.5, 1234568.0, 54, 426, 0], "y": [1e-3, 10.0, 202, 26, 1],
        "q": ["it's <q>", "m²", "error", ""],
    }  # fmt: skip


def test_bands_and_strips_are_as_wide_as_their_time():
    one = plot()
    one.band(1.0, 2.0, "touch")
    one.band(3.0, 3.0, "thin")
    one.strip(1.0, 2.0, "planned")
    one.strip(3.0, 3.0, "second")
    svg = str(one.markup())
    assert not unsaid(
        svg, '<rect class="touch" x="147.0" y="26" width="93.0" height="176"/>',
        '<rect class="thin" x="333.0" y="26" width="0.5" height="176"/>',
        '<rect class="planned" x="147.0" y="20" width="93.0" height="4"/>',
        '<rect class="second" x="333.0" y="20" width="1.0" height="4"/>',
    )  # fmt: skip


def test_a_line_is_drawn_where_both_of_its_values_are_known():
    one = plot()
    one.line("known", " c1 ", [0.0, 1.0, 2.0, 3.0, 4.0], [0.5, float("nan"), -0.5, 1.0])
    one.line("shorter times", "c2", [0.0, float("nan"), 2.0], [0.0, 0.0, 1.0, 1.0])
    one.line("unknown", "c3", [0.0, 1.0], [float("nan"), float("inf")])
    assert drawn(one).lines == {
        "known": ("c1", [(0.0, 0.5), (2.0, -0.5), (3.0, 1.0)]),
        "shorter times": ("c2", [(0.0, 0.0), (2.0, 1.0)]),
    }  # fmt: skip
    assert 'd="M54,70l186 88 93-132"' in str(one.markup())


def test_a_single_point_of_a_line_is_a_dot():
    one = plot()
    one.line("dot", "c0", [1.0], [0.0])
    assert 'd="M147,114l0,0"' in str(one.markup())


def placed(one: Plot) -> list[tuple[str, str, str]]:
    return re.findall(r'<text class="tag [^"]*" x="([^"]+)" y="([^"]+)">(.*?)<', str(one.markup()))


@pytest.mark.parametrize(
    ("taken", "place"),
    [
        ([], ("391.0", "66.0")), ([(3.9, 0.55)], ("391.0", "84.0")),
        ([(3.9, 0.55), (3.9, 0.4)], ("58.0", "66.0")),
        ([(3.9, 0.55), (3.9, 0.4), (0.1, 0.55)], ("58.0", "84.0")),
        ([(3.9, 0.55), (3.9, 0.4), (0.1, 0.55), (0.1, 0.4)], ("203.5", "66.0")),
    ],
)  # fmt: skip
def test_a_level_is_named_at_its_right_end_or_where_there_is_room(
    taken: list[tuple[float, float]], place: tuple[str, str]
):
    """Five characters of 6.6 pixels end at 424, begin at 58, or are about 220.

    4 above the line at 70, or 18 lower.
    """
    one = plot()
    one.level(0.5, "limit")
    for x, y in taken:
        one.point(x, y, "c0", "circle", "")
    assert placed(one) == [(*place, "limit")]
    assert placed(one) == [(*place, "limit")], "once, however often the plot is written"


def test_a_level_is_a_line_over_the_whole_width():
    one = plot()
    one.level(0.5, "limit")
    assert drawn(one).lines == {"limit": ("level", [(0.0, 0.5), (4.0, 0.5)])}
    assert 'd="M54,70.0H426"' in str(one.markup())


@pytest.mark.parametrize(("free", "side"), [(True, "66.0"), (False, "66.0")])
def test_labels_keep_free_of_points_that_ask_for_it(free: bool, side: str):
    one = plot()
    one.point(1.0, 0.5, "c0", "circle", "", radius=3.0, keeps_free=free)
    assert one.label(147.0, 66.0, "ab", pixels=True)
    top = "52.0" if free else side
    assert placed(one) == [("147.0", top, "ab")]


@pytest.mark.parametrize(
    ("x", "y", "words", "style", "place"),
    [
        (147.0, 100.0, "ab", "", ("147.0", "100.0")), (40.0, 100.0, "ab", "", ("56.0", "100.0")),
        (430.0, 100.0, "ab", "", ("424.8", "100.0")),
        (430.0, 100.0, "ab", "strong", ("422.4", "100.0")),
        (147.0, 10.0, "ab", "", ("147.0", "38.0")), (147.0, 25.0, "ab", "", ("147.0", "25.0")),
        (147.0, 24.0, "ab", "", ("147.0", "38.0")), (147.0, 201.0, "ab", "", ("147.0", "201.0")),
        (147.0, 202.0, "ab", "", ("147.0", "188.0")),
    ],
)  # fmt: skip
def test_a_label_stays_inside(x: float, y: float, words: str, style: str, place: tuple[str, str]):
    one = plot()
    assert one.label(x, y, words, style, pixels=True)
    assert placed(one) == [(*place, words)]


def test_a_label_at_a_value_stands_five_pixels_above_it_and_others_move_past_it():
    one = plot()
    for _ in range(8):
        one.label(1.0, 0.0, "ab")
    assert placed(one) == [
        ("147.0", f"{109 + shift}.0", "ab") for shift in (0, -14, 14, -28, 28, -42, 42)
    ]


def test_names_of_points_are_joined_where_these_are_close():
    one = plot()
    one.name_points(
        [
            (1.0, 0.0, "first"),
            (1.09, 0.0, "second"),
            (1.0, 0.1, "third"),
            (1.0, 0.11, "above"),
            (3.5, 0.0, "far"),
        ]
    )
    # 8.37 pixels to the right and 8.8 above are close, 9.68 above are not.
    assert placed(one) == [
        ("154.0", "108.0", "first and 2 more"),
        ("127.5", "123.3", "above"),
        ("386.5", "108.0", "far"),
    ]


BESIDE = [
    (165, 106),
    (165, 112),
    (145, 100),
    (145, 130),
    (130, 112),
    (165, 125),
]  # each in the way of one place


@pytest.mark.parametrize(
    ("taken", "place"),
    [
        (0, (154.0, 108.0)), (1, (156.0, 118.0)), (2, (139.2, 104.0)), (3, (139.2, 133.0)),
        (4, (122.4, 118.0)), (5, (154.0, 130.0)), (6, (156.0, 90.0)),
    ],
)  # fmt: skip
def test_a_name_goes_round_its_point_until_there_is_room(taken: int, place: tuple[float, float]):
    """Two bold characters of 7.8 pixels beside (147, 114): to the right and up, to the right, above, below, to the left; or moved as labels are."""
    one = plot()
    for x, y in BESIDE[:taken]:
        one.point((x - 54) / 93, (114 - y) / 88, "c0", "circle", "", radius=-0.9)
    one.name_points([(1.0, 0.0, "ab")])
    ((x, y, _),) = placed(one)
    assert (float(x), float(y)) == pytest.approx(place, abs=0.06)


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
    flat = [
        int(value) for value in np.ascontiguousarray(planes.reshape(8, -1).T).view("<u8").ravel()
    ]
    signed = [-(value + 1) // 2 if value % 2 else value // 2 for value in flat]
    return signed[: 1 + 4 * signed[0]]


@pytest.mark.parametrize(
    ("x", "y", "values", "found"),
    [
        (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (0.5, 0.5), [-6, -4]),
        (Axis("t", "", 1.0, 501.0), Axis("q", "", -300.0, 200.0), (2.0, 2.0), [-4, -2]),
        (Axis("t", "", 0.0, 0.05), Axis("q", "", 0.0, 0.9), (0.01, 0.5), [-8, -5]),
        (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (2e12, -2e12), [-1, -1]),
        (Axis("t", "", 1.0, 10.0, log=True), Axis("q", "", 0.1, 10.0, log=True), (2.0, 3.0),
         [-5, -5]), (Axis("t", "", 0.0, 1.0), Axis("q", "", 0.0, 1.0), (1e9, 1e11), [-5, -3]),
    ],
)  # fmt: skip
def test_grains_are_a_share_of_the_axis_but_no_finer_than_what_is_exact(
    x: Axis, y: Axis, values: tuple[float, float], found: list[int]
):
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


@pytest.mark.parametrize(
    ("xs", "ys", "kept"),
    [
        ([], [], []), ([0], [5], [0]), ([0, 1], [5, 9], [0, 1]), ([0, 1, 2], [0, 0, 0], [0, 2]),
        # Nine tenths of 0.1 are a point's that is alone.
        ([0, 1, 2], [0, 0.089, 0], [0, 2]), ([0, 1, 2], [0, 0.091, 0], [0, 1, 2]),
        ([0, 1, 2], [0, -0.089, 0], [0, 2]), ([0, 1, 2], [0, -0.091, 0], [0, 1, 2]),
        ([0, 2, 4], [1, 1.089, 1], [0, 2]), ([0, 2, 4], [1, 1.091, 1], [0, 1, 2]),
        ([0, 1, 2, 3, 4], [0, 0, 1, 0, 0], [0, 1, 2, 3, 4]),
        # Slopes from the first point may lie from 0.005 to 0.095 after the third.
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.02], [0, 3]),
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.01], [0, 2, 3]),
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.28], [0, 3]),
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.3], [0, 2, 3]),
        ([0, 1, 2, 3], [0, -0.08, -0.1, -0.28], [0, 3]),
        ([0, 1, 2, 3], [0, -0.08, -0.1, -0.3], [0, 2, 3]),
        ([0, 1, 10, 11], [0, 0.08, 0.0, 0.5], [0, 2, 3]),
        # Jumps are kept, what is less than a line's width is not.
        ([0, 1, 1, 2], [0, 0, 5, 5], [0, 1, 2, 3]), ([0, 1, 1, 2], [0, 0, -5, -5], [0, 1, 2, 3]),
        ([0, 1, 1, 2], [0, 0, 0.089, 0], [0, 3]),
        ([0, 1, 1, 2], [0, 0, -0.089, 0], [0, 3]), ([0, 1, 1, 2], [0, 0, 0.091, 0], [0, 1, 2, 3]),
        ([0, 0, 1, 2], [0, 5, 5, 5], [0, 1, 3]),
        ([0, 1, 1, 1, 2], [0, 0, 5, 9, 9], [0, 1, 2, 3, 4]),
        ([0, 1, 1, 2, 3], [0, 0, 5, 6, 7], [0, 1, 2, 4]),
        ([3, 4, 5], [0, 1, 2], [0, 2]), ([3, 4, 5, 6], [7, 8, 8, 8], [0, 1, 3]),
    ],
)  # fmt: skip
def test_points_that_are_kept(xs: list[float], ys: list[float], kept: list[int]):
    assert seen(np.array(xs, float), np.array(ys, float), 0.1) == kept


def distances(xs: np.ndarray, ys: np.ndarray, kept: list[int]) -> float:
    """How far a point lies above or below what is drawn, at most.

    Of a jump the nearest of its points counts.
    """
    far = 0.0
    for first, last in pairwise(kept):
        inside = slice(first, last + 1)
        run = xs[last] - xs[first]
        line = (
            ys[first] + (ys[last] - ys[first]) * (xs[inside] - xs[first]) / run
            if run > 0
            else np.clip(ys[inside], *sorted((ys[first], ys[last])))
        )
        far = max(far, float(np.abs(line - ys[inside]).max()))
    return far


@pytest.mark.parametrize("tolerance", [0.25, 0.01])
@pytest.mark.parametrize("shape", ["wave", "noise", "steps", "steep", "corner"])
def test_of_long_lines_nothing_that_is_seen_is_left_out_and_little_is_kept(
    shape: str, tolerance: float
):
    random, xs = np.random.default_rng(3), np.linspace(54.0, 426.0, 1201)
    ys = {
        "wave": 100.0 * np.sin(xs / 30.0), "noise": np.cumsum(random.normal(size=1201)) * tolerance,
        "steps": 50.0 * np.floor(xs / 40.0),
        "steep": -3.0 * xs, "corner": np.abs(xs - 234.0625),
    }[shape]  # fmt: skip
    kept = seen(xs, ys, tolerance)
    assert (kept[0], kept[-1], sorted(set(kept))) == (0, 1200, kept)
    assert distances(xs, ys, kept) <= tolerance * 1.0001
    assert (
        len(kept)
        <= {
            "wave": 450 if tolerance < 0.1 else 80,
            "noise": 900,
            "steps": 22,
            "steep": 2,
            "corner": 4,
        }[shape]
    )


def test_times_that_stand_still_keep_every_jump():
    xs = np.repeat(np.arange(20.0), 2)
    ys = np.tile([0.0, 9.0], 20)
    assert seen(xs, ys, 0.1) == list(range(40))
