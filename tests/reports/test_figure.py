"""A plot's pixels by hand: 440 by 240, of which x has those from 54 to 426 and y those from 202 up to 26."""

import html
import json
import re

import pytest
from wording import unsaid

from reports.plots import Axis, Plot
from tests.reports.drawn import drawn


def plot(**changes) -> Plot:
    return Plot("a plot", Axis("time", "s", 0.0, 4.0), Axis("force", "N^2", -1.0, 1.0), **changes)


def test_grid_ticks_and_titles_stand_where_they_belong():
    svg = str(plot().markup())
    assert not unsaid(
        svg, '<path class="grid x" d="M54,26V202M147,26V202M240,26V202M333,26V202M426,26V202"/>',
        '<path class="grid" d="M54,202H426M54,158H426M54,70H426M54,26H426"/><path class="grid zero" d="M54,114H426"/>',
        '<g class="tick x"><text x="54" y="217">0</text><text x="147" y="217">1</text><text x="240" y="217">2</text>',
        '<text x="426" y="217">4</text></g><g class="tick"><text x="48" y="206">−1</text><text x="48" y="162">−0.5</text><text x="48" y="118">0</text>',
        '<path class="frame" d="M54,26V202H426"/>',
        '<text class="axis x" x="426" y="234">time [s]</text><text class="axis" x="2" y="12">force [N²]</text>',
        '<svg class="plot" viewBox="0 0 440 240"', ' aria-hidden="true">',
    )  # fmt: skip
    assert "aria-hidden" not in str(plot().markup(hidden=False))
    # 660 and 330 pixels, less the margins, have room for 9 and 8 labels.
    wide = str(plot(width=660, height=330).markup())
    assert re.findall(r'<text x="([\d.]+)" y="307">', wide) == ["54", "128", "202", "276", "350", "424", "498", "572", "646"]
    assert re.findall(r'<text x="48" y="([\d.]+)">', wide) == ["296", "262.8", "229.5", "196.2", "163", "129.8", "96.5", "63.2", "30"]
    small = str(plot(width=120, height=80).markup())
    assert (small.count(' y="57">'), small.count('<text x="48"')) == (3, 3), "three labels at least are asked for"


def test_labels_are_as_many_as_have_room_inside_the_frame():
    """Of 400 by 240 pixels 332 and 176 are inside: room for five labels each, which a range of three tells from six."""
    one = Plot("a plot", Axis("time", "s", 0.0, 3.0), Axis("force", "N", 0.0, 3.0), width=400)
    below, left = re.findall(r'<g class="tick[^"]*">(.*?)</g>', str(one.markup()))
    assert [re.findall(r">([\d.]+)<", ticks) for ticks in (below, left)] == [["0", "1", "2", "3"]] * 2


def test_the_script_is_told_the_axes_and_their_pixels():
    mixed = Plot("a plot", Axis("it's <q>", "m^2", 0.5, 1234567.89), Axis("error", "", 1e-3, 10.0, log=True))
    found = re.search(r"data-axes='([^']*)'", str(mixed.markup()))
    assert json.loads(html.unescape(found[1])) == {
        "x": [0.5, 1234568.0, 54, 426, 0], "y": [1e-3, 10.0, 202, 26, 1], "q": ["it's <q>", "m²", "error", ""],
    }  # fmt: skip


def test_bands_and_strips_are_as_wide_as_their_time():
    one = plot()
    one.band(1.0, 2.0, "touch")
    one.band(3.0, 3.0, "thin")
    one.strip(1.0, 2.0, "planned", 0)
    one.strip(3.0, 3.0, "second", 2)
    svg = str(one.markup())
    assert not unsaid(
        svg, '<rect class="touch" x="147.0" y="26" width="93.0" height="176"/>', '<rect class="thin" x="333.0" y="26" width="0.5" height="176"/>',
        '<rect class="planned" x="147.0" y="20" width="93.0" height="4"/>', '<rect class="second" x="333.0" y="8" width="1.0" height="4"/>',
    )  # fmt: skip


def test_a_line_is_drawn_where_both_of_its_values_are_known():
    one = plot()
    one.line("known", " c1 ", [0.0, 1.0, 2.0, 3.0, 4.0], [0.5, float("nan"), -0.5, 1.0])
    one.line("shorter times", "c2", [0.0, float("nan"), 2.0], [0.0, 0.0, 1.0, 1.0])
    one.line("unknown", "c3", [0.0, 1.0], [float("nan"), float("inf")])
    assert drawn(one).lines == {
        "known": ("c1", [(0.0, 0.5), (2.0, -0.5), (3.0, 1.0)]), "shorter times": ("c2", [(0.0, 0.0), (2.0, 1.0)]),
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
        ([], ("391.0", "66.0")), ([(3.9, 0.55)], ("391.0", "84.0")), ([(3.9, 0.55), (3.9, 0.4)], ("58.0", "66.0")),
        ([(3.9, 0.55), (3.9, 0.4), (0.1, 0.55)], ("58.0", "84.0")), ([(3.9, 0.55), (3.9, 0.4), (0.1, 0.55), (0.1, 0.4)], ("203.5", "66.0")),
    ],
)  # fmt: skip
def test_a_level_is_named_at_its_right_end_or_where_there_is_room(taken: list[tuple[float, float]], place: tuple[str, str]):
    """Five characters of 6.6 pixels end at 424, begin at 58, or are about 220; 4 above the line at 70, or 18 lower."""
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
        (147.0, 100.0, "ab", "", ("147.0", "100.0")), (40.0, 100.0, "ab", "", ("56.0", "100.0")), (430.0, 100.0, "ab", "", ("424.8", "100.0")),
        (430.0, 100.0, "ab", "strong", ("422.4", "100.0")), (147.0, 10.0, "ab", "", ("147.0", "38.0")), (147.0, 25.0, "ab", "", ("147.0", "25.0")),
        (147.0, 24.0, "ab", "", ("147.0", "38.0")), (147.0, 201.0, "ab", "", ("147.0", "201.0")), (147.0, 202.0, "ab", "", ("147.0", "188.0")),
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
    assert placed(one) == [("147.0", f"{109 + shift}.0", "ab") for shift in (0, -14, 14, -28, 28, -42, 42)]


def test_names_of_points_are_joined_where_these_are_close():
    one = plot()
    one.name_points([(1.0, 0.0, "first"), (1.09, 0.0, "second"), (1.0, 0.1, "third"), (1.0, 0.11, "above"), (3.5, 0.0, "far")])
    # 8.37 pixels to the right and 8.8 above are close, 9.68 above are not.
    assert placed(one) == [("154.0", "108.0", "first and 2 more"), ("127.5", "123.3", "above"), ("386.5", "108.0", "far")]


BESIDE = [(165, 106), (165, 112), (145, 100), (145, 130), (130, 112), (165, 125)]  # each in the way of one place


@pytest.mark.parametrize(
    ("taken", "place"),
    [
        (0, (154.0, 108.0)), (1, (156.0, 118.0)), (2, (139.2, 104.0)), (3, (139.2, 133.0)), (4, (122.4, 118.0)), (5, (154.0, 130.0)), (6, (156.0, 90.0)),
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
