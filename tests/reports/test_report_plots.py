"""Axes, the thinning of lines, phases of contact, and what is let through as MathML."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.pages.scene import safe_mathml
from reports.plots import Axis, Plot


@given(st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=20), st.booleans())
def test_a_fitted_axis_holds_its_values_and_its_ticks(values, zero):
    axis = Axis.fitted("q", "m", values, zero=zero)
    assert all(-1e-9 <= axis.fraction(value) <= 1 + 1e-9 for value in values)
    ticks = axis.ticks()
    assert 1 <= len(ticks) <= 9
    assert all(-1e-6 <= axis.fraction(value) <= 1 + 1e-6 for value, _ in ticks)


@given(st.lists(st.floats(1e-190, 1e190), min_size=1, max_size=20))
def test_a_logarithmic_axis_holds_its_values(values):
    axis = Axis.fitted("q", "m", values, log=True)
    assert all(-1e-9 <= axis.fraction(value) <= 1 + 1e-9 for value in values)
    assert axis.ticks()


def _points(path: str) -> list[tuple[float, float]]:
    """Of a path Mx,yldx dy dx-dy ..: its points [pixel]; a sign parts numbers as a space does."""
    numbers = [float(number) for number in re.findall(r"-?[\d.]+", path)]
    return [tuple(point) for point in np.cumsum(np.reshape(numbers, (-1, 2)), axis=0)]


def test_every_marker_stands_around_its_point():
    """The point (1, 2) of axes 0..2, 0..4 is at (240, 114) of 440 by 240 pixels, by hand: each shape's corners are as far to both sides."""
    corners = {}
    for marker in ("circle", "square", "diamond", "triangle"):
        plot = Plot("one", Axis("x", "m", 0.0, 2.0), Axis("y", "m", 0.0, 4.0))
        plot.point(1.0, 2.0, "s", marker, "tip")
        (shape,) = re.findall(r"</title><(.+?)/></g>", plot.markup())
        says = {
            name: float(value)
            for name, value in re.findall(r'\b(x|y|width|height|cx|cy|r)="([-\d.]+)"', shape)
        }
        if marker == "circle":
            corners[marker] = (
                says["cx"] - says["r"],
                says["cx"] + says["r"],
                says["cy"] - says["r"],
                says["cy"] + says["r"],
            )
        elif marker == "square":
            corners[marker] = (
                says["x"],
                says["x"] + says["width"],
                says["y"],
                says["y"] + says["height"],
            )
        else:
            place = [
                np.array(list(map(float, pair.split(","))))
                for pair in re.findall(r"[-\d.]+,[-\d.]+", shape)
            ]
            ends = np.cumsum(place, axis=0)
            back = float(match[1]) if (match := re.search(r"h(-[\d.]+)z", shape)) else 0.0
            across = [*ends[:, 0], ends[-1, 0] + back]
            corners[marker] = (min(across), max(across), min(ends[:, 1]), max(ends[:, 1]))
    for marker, (left, right, top, bottom) in corners.items():
        assert (left + right) / 2 == pytest.approx(240.0, abs=0.1), marker
        assert (top + bottom) / 2 == pytest.approx(114.0, abs=1.0), (
            marker
        )  # a triangle's middle is lower than its corners'
        assert 9.0 <= right - left <= 12.0, marker
        assert 9.0 <= bottom - top <= 12.0, marker


def test_on_logarithmic_axes_a_line_goes_through_its_points_and_decades_are_equally_far():
    """440 by 240 pixels: x from 54 to 426 over six decades, y from 202 up to 26 over eight, by hand."""
    plot = Plot(
        "slope", Axis("step", "s", 1e-3, 1e3, log=True), Axis("error", "m", 1e-6, 1e2, log=True)
    )
    xs, ys = [1e-3, 1e-1, 1.0, 1e2, 1e3], [1e-6, 1e2, 1e-2, 1e0, 1e-4]
    plot.line("e", "c0", xs, ys)
    for x, y in zip(xs, ys, strict=True):
        plot.point(x, y, "c0", "circle", "a tip")
    markup = plot.markup()
    by_hand = [(54.0, 202.0), (178.0, 26.0), (240.0, 114.0), (364.0, 70.0), (426.0, 158.0)]
    path = re.search(r'data-n="e" d="M([^"]+)"', markup)
    assert _points(path[1]) == [pytest.approx(place, abs=0.11) for place in by_hand]
    circles = re.findall(r'<circle cx="([^"]+)" cy="([^"]+)"', markup)
    assert [tuple(map(float, place)) for place in circles] == [
        pytest.approx(place, abs=0.06) for place in by_hand
    ]
    plot.level(1e-2, "limit")
    assert 'd="M54,114.0H426"' in plot.markup()
    assert [
        value for value, _ in Axis("step", "s", 0.5e-3, 2e3, log=True).ticks(most=7)
    ] == pytest.approx([1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0, 1000.0])


@pytest.mark.parametrize("log", [False, True])
def test_what_lies_outside_is_at_its_own_side(log: bool):
    axis = Axis("q", "m", 1.0, 100.0, log=log)
    assert axis.fraction(1.0) == 0.0
    assert axis.fraction(100.0) == 1.0
    assert axis.fraction(10.0) == pytest.approx(0.5 if log else 1.0 / 11.0)
    assert axis.fraction(1e9) == 1.5
    assert axis.fraction(1e-9 if log else -1e9) == -0.5
    values = [1e-9, 1.0, 3.0, 10.0, 55.0, 100.0, 1e9]
    assert axis.fraction(values) == pytest.approx([axis.fraction(value) for value in values])


def test_mathml_is_let_through():
    markup = safe_mathml(
        '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block"><mi>k</mi><mo>&lt;</mo><mn>1</mn></math>'
    )
    assert markup == '<math display="block"><mi>k</mi><mo>&lt;</mo><mn>1</mn></math>'


@pytest.mark.parametrize(
    "text",
    [
        "<math><script>1</script></math>",
        '<math><annotation-xml encoding="text/html"><img src="x"/></annotation-xml></math>',
        "<math><mtext><img/></mtext></math>",
        '<!DOCTYPE math [<!ENTITY a "aaaa">]><math><mi>&a;</mi></math>', "<math><mi>k</math>",
        "<p>text</p>", "",
        "<math>" + "<mrow>" * 500 + "</mrow>" * 500 + "</math>",
    ],
)  # fmt: skip
def test_what_is_not_mathml_is_not(text):
    assert safe_mathml(text) is None


@pytest.mark.parametrize(
    ("inside", "shown"),
    [
        ("<mo>-</mo>", "<mo>−</mo>"), ("<mi>ⅆ</mi>", "<mi>d</mi>"), ("<mo>+</mo>", "<mo>+</mo>"),
        ("<mrow><mi>a</mi>b<mi/>&lt;</mrow>", "<mrow><mi>a</mi>b<mi></mi>&lt;</mrow>"),
        ('<mi mathvariant="a&quot;b">x</mi>', '<mi mathvariant="a&#34;b">x</mi>'),
        ("<mi>a\x0cb</mi>", "<mi>ab</mi>"), ("<?php x?>", None),
        ("<mi>" + "x" * 200_000 + "</mi>", None),
        ("<mrow>" * 60 + "</mrow>" * 60, "<mrow>" * 60 + "</mrow>" * 60),
        ("<mrow>" * 61 + "</mrow>" * 61, None),
        ("<mi>" + "x" * (200_000 - 22) + "</mi>", "<mi>" + "x" * (200_000 - 22) + "</mi>"),
        ("<mi>" + "x" * (200_001 - 22) + "</mi>", None),
    ],
    ids=range(12),
)  # fmt: skip
def test_signs_and_texts_of_mathml(inside: str, shown: str | None):
    """Elements may be sixty deep, and the text 200 000 long, of which 22 are tags."""
    assert safe_mathml(f"<math>{inside}</math>") == (
        None if shown is None else f"<math>{shown}</math>"
    )


def test_attributes_of_mathml_that_could_act_are_dropped():
    markup = safe_mathml(
        '<math onclick="alert(1)" href="javascript:1" style="x" display="block"><mi class="c">k</mi></math>'
    )
    assert markup == '<math display="block"><mi>k</mi></math>'
