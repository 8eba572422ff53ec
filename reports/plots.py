"""Plots as SVG text, readable without scripts.

    plot = Plot("Contact force", Axis.fitted("time", "s", t), Axis.fitted("force", "N", force))
    plot.line("plan", "p", t, force);  plot.markup()

Colours are CSS classes, so that the page's light, dark and print styles apply. `packed` stores all
numbers for reading, zooming and saving. 105,000 numbers take 44 kB instead of 311 kB of compressed
JSON.
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from reports.wording import number, power, unit

_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
# Smallest ratio of values on a logarithmic axis.
_WIDE = 20.0
# Largest drawn value (and inverse of the smallest), with room for margins before overflow.
_LARGEST = 1e200


def is_wide(values: Sequence[float]) -> bool:
    """Return whether values are positive and span more than a factor of 20."""
    return min(values) > 0 and max(values) / min(values) > _WIDE


@dataclass(frozen=True)
class Axis:
    """An axis; labels are divided by 10**exponent, which the title states."""

    quantity: str
    unit: str
    low: float
    high: float
    log: bool = False
    exponent: int = 0

    @staticmethod
    def fitted(
        quantity: str,
        unit: str,
        values: Iterable[float] | NDArray[np.float64],
        *,
        log: bool = False,
        margin: float = 0.05,
        zero: bool = False,
    ) -> Axis:
        """Return an axis that holds all finite values (n,) [unit of the axis]. Raises nothing.

        margin: room at both ends, as a share of the range [-]; zero: a linear axis includes zero.
        """
        smallest = 1 / _LARGEST if log else -_LARGEST
        array = np.fromiter(values, np.float64)
        usable = array[(smallest <= array) & (array <= _LARGEST)]
        if zero and not log:
            usable = np.append(usable, 0.0)
        low, high = (
            (float(usable.min()), float(usable.max()))
            if len(usable)
            else (1e-3 if log else 0.0, 1.0)
        )
        if log:
            room = max(0.12, margin * (math.log10(high) - math.log10(low)))
            return Axis(quantity, unit, low * 10**-room, high * 10**room, True)
        if zero and low == high == 0:
            high = 1.0
        if high - low <= max(1e-12 * max(abs(low), abs(high)), 1 / _LARGEST):
            # A constant is centred in a range of its own size.
            half = abs(high) / 2 if abs(high) > 1 / _LARGEST else 0.5
            low, high = low - half, high + half
        room = margin * (high - low)
        largest = max(abs(low), abs(high))
        exponent = math.floor(math.log10(largest)) if largest < 1e-2 or largest >= 1e5 else 0
        low, high = (
            low - (0.0 if zero and low == 0 else room),
            high + (0.0 if zero and high == 0 else room),
        )
        return Axis(quantity, unit, low, high, False, exponent)

    @property
    def title(self) -> str:
        """Return the quantity with its unit, and the power of ten of its labels."""
        words = unit(self.unit)
        if self.exponent:
            words = f"{power(self.exponent)} {words}".strip()
        return f"{self.quantity} [{words}]" if words else self.quantity

    def fraction(self, values: float | Sequence[float] | NDArray[np.float64]) -> Any:
        """Return positions of values, one or (n,) [unit of the axis], from 0 (low) to 1 (high) [-].

        Outside values are clipped to just outside. Raises nothing.
        """
        array = np.asarray(values, np.float64)
        if self.log:
            begin = math.log10(self.low)
            position = (np.log10(np.maximum(array, 1 / _LARGEST)) - begin) / (
                math.log10(self.high) - begin
            )
        else:
            with np.errstate(over="ignore"):  # overflow is clipped
                position = (array - self.low) / (self.high - self.low)
        return np.clip(position, -0.5, 1.5)

    def ticks(self, most: int = 6) -> list[tuple[float, str]]:
        """Return about `most` pairs (value, label)."""
        return self._decades(most) if self.log else self._linear(most)

    def _decades(self, most: int) -> list[tuple[float, str]]:
        first, last = (
            math.ceil(math.log10(self.low) - 1e-9),
            math.floor(math.log10(self.high) + 1e-9),
        )
        if last - first >= 2:
            stride = max(1, math.ceil((last - first + 1) / most))
            plain = first >= -3 and last <= 3
            exponents = range(first, last + 1, stride)
            labels = [
                number(10.0**exponent, 1) if plain or 0 <= exponent <= 1 else power(exponent)
                for exponent in exponents
            ]
            return [
                (10.0**exponent, words) for exponent, words in zip(exponents, labels, strict=True)
            ]
        values = [
            mantissa * 10.0**exponent
            for exponent in range(first - 1, last + 2)
            for mantissa in (1, 2, 3, 5)
        ]
        inside = [value for value in values if self.low <= value <= self.high]
        if len(inside) < 2:
            # Fewer than two of these: as good as linear.
            return self._linear(most)
        return [
            (value, number(value, 2))
            for value in (
                inside if 2 <= len(inside) <= most else inside[:: max(1, len(inside) // most)]
            )
        ]

    def _linear(self, most: int) -> list[tuple[float, str]]:
        raw = (self.high - self.low) / most
        magnitude = 10.0 ** math.floor(math.log10(raw))
        step = next(nice * magnitude for nice in _NICE if nice * magnitude >= raw * 0.999)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        scale = 10.0**self.exponent
        # At least four digits, and enough to distinguish neighbours.
        digits = max(4, math.ceil(math.log10(max(abs(first), abs(last), 1))) + 1)
        return [
            (place * step, number(place * step / scale, digits)) for place in range(first, last + 1)
        ]


# Grain of x over its range, as a power of ten; must distinguish 1,500 times.
_OF_X = -6
# Grain of y; a finer one adds half as much.
_OF_Y = -4
# Grain of a decade of a logarithmic axis: five digits.
_OF_DECADE = -5
# Integers up to 10^14, and their second differences, are exact in the script.
_EXACT = 14
# Logarithmic value of numbers that are not positive, never shown.
_SMALLEST = 1e-200
# Points per stretch tested for straightness.
_STRETCH = 8
# Share of the tolerance for stretches.
_STRAIGHT = 0.1

Array = NDArray[np.float64]


def packed(series: Sequence[tuple[Array, Array]], x: Axis, y: Axis) -> str:
    """Return the series of a plot as base64 text.

    The text is a zlib stream of 64 bit integers, first all lowest bytes, then the next ones:

    - the number of series.
    - count and grain's exponent of each x (count 0: as before) and y.
    - second differences of all columns.

    Parameters
    ----------
    series
        Pairs of x and y (n,) [units of the axes], all finite.
    x, y
        The axes.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    heads, steps = [len(series)], []
    before = np.zeros(0)
    for xs, ys in series:
        for values, axis, fine in (
            (xs[:0] if np.array_equal(before, xs) else xs, x, _OF_X),
            (ys, y, _OF_Y),
        ):
            exponent, grains = _grains(values, axis, fine)
            heads += [len(grains), exponent]
            steps.append(np.diff(grains, 2, prepend=[0, 0]))
        before = xs
    flat = np.concatenate([heads, *steps]).astype("<i8")
    unsigned = (flat << 1) ^ (flat >> 63)
    return base64.b64encode(
        zlib.compress(unsigned.view(np.uint8).reshape(-1, 8).T.tobytes(), 9)
    ).decode()


def _grains(values: Array, axis: Axis, fine: int) -> tuple[int, NDArray[np.int64]]:
    """Return the exponent of a column's grain, and the column in grains (of its log10 if log)."""
    if axis.log:
        return _OF_DECADE, np.rint(
            np.log10(np.maximum(values, _SMALLEST)) / 10.0**_OF_DECADE
        ).astype(np.int64)
    largest = float(np.abs(values).max(initial=axis.high - axis.low))
    exponent = max(
        math.floor(math.log10(axis.high - axis.low)) + fine, math.ceil(math.log10(largest)) - _EXACT
    )
    return exponent, np.rint(values / 10.0**exponent).astype(np.int64)


def seen(xs: NDArray[np.float64], ys: NDArray[np.float64], tolerance: float) -> list[int]:
    """Return indices (k,) [-] of points so that all others are within the tolerance of the line.

    xs: (n,) [pixel], not decreasing; ys: (n,) [pixel]; tolerance [pixel]. A cone of slopes from the
    last kept point narrows until it closes. Raises ValueError if the shapes do not fit.
    """
    if len(xs) < 3:
        return list(range(len(xs)))
    places = _bent(xs, ys, _STRAIGHT * tolerance)
    tolerance *= 1 - _STRAIGHT
    kept = [0]
    points = zip(places.tolist(), xs[places].tolist(), ys[places].tolist(), strict=True)
    previous, previous_x, previous_y = next(points)
    anchor_x, anchor_y = previous_x, previous_y
    low, high = -math.inf, math.inf
    for place, x, y in points:
        run = x - anchor_x
        if run > 1e-9:
            slope, width = (y - anchor_y) / run, tolerance / run
            if low <= slope <= high:
                if slope - width > low:
                    low = slope - width
                if slope + width < high:
                    high = slope + width
                previous, previous_x, previous_y = place, x, y
                continue
        elif abs(y - previous_y) <= tolerance:
            continue
        if previous != kept[-1]:
            kept.append(previous)
        anchor_x, anchor_y = previous_x, previous_y
        run = x - anchor_x
        if run > 1e-9:
            slope, width = (y - anchor_y) / run, tolerance / run
            low, high = slope - width, slope + width
        else:
            kept.append(place)
            anchor_x, anchor_y = x, y
            low, high = -math.inf, math.inf
        previous, previous_x, previous_y = place, x, y
    if previous != kept[-1]:
        kept.append(previous)
    return kept


def _bent(xs: NDArray[np.float64], ys: NDArray[np.float64], tolerance: float) -> NDArray[np.int64]:
    """Return indices without inner points of stretches that are straight within the tolerance."""
    ends = np.arange(0, len(xs) - _STRETCH, _STRETCH)
    run, rise = xs[ends + _STRETCH] - xs[ends], ys[ends + _STRETCH] - ys[ends]
    slope = rise / np.where(run > 0, run, 1.0)
    inside = ends[:, None] + np.arange(1, _STRETCH)
    away = np.abs(ys[inside] - ys[ends, None] - slope[:, None] * (xs[inside] - xs[ends, None]))
    bent = np.ones(len(xs), bool)
    bent[inside[(away.max(axis=1, initial=0.0) <= tolerance) & (run > 0)]] = False
    return np.flatnonzero(bent)


# Largest distance of an omitted point from the line [pixel].
_TOLERANCE = 0.4
# Digits of the axes' ends, from which the script computes pixels.
_DIGITS = 7
# Width of a plain character of the 12 px font, an upper estimate [pixel].
_CHARACTER = 6.6
# Width of a bold character [pixel].
_BOLD = 7.8
# Distance of lines [pixel].
_LINE = 14.0
# Positions of a name relative to its point [pixel], and its anchor.
_PLACES = (
    (7, -6, "start"),
    (9, 4, "start"),
    (0, -10, "middle"),
    (0, 19, "middle"),
    (-9, 4, "end"),
    (7, 16, "start"),
)
_SHIFTS = (0, -_LINE, _LINE, -2 * _LINE, 2 * _LINE, -3 * _LINE, 3 * _LINE)


@dataclass(frozen=True)
class Key:
    """One entry of a legend: CSS class of the line or marker, and words."""

    style: str
    words: str
    marker: str = ""


@dataclass
class Plot:
    """A plot; words: its content in a sentence, for readers without sight."""

    title: str
    x: Axis
    y: Axis
    words: str = ""
    width: int = 440
    height: int = 240
    keys: list[Key] = field(default_factory=list)
    _under: list[str] = field(default_factory=list)
    _lines: list[str] = field(default_factory=list)
    _over: list[str] = field(default_factory=list)
    _levels: list[tuple[float, str]] = field(default_factory=list)
    _series: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=list)
    _points: list[tuple[float, float]] = field(default_factory=list)
    _taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    _LEFT = 54
    _RIGHT = 14
    _TOP = 26
    _BOTTOM = 38

    def px(self, values: float | NDArray[np.float64]) -> Any:
        """Return pixels from the left of x, one or (n,) [unit of x]. Raises nothing."""
        return self._LEFT + self.x.fraction(values) * (self.width - self._LEFT - self._RIGHT)

    def py(self, values: float | NDArray[np.float64]) -> Any:
        """Return pixels from the top of y, one or (n,) [unit of y]. Raises nothing."""
        return (
            self.height
            - self._BOTTOM
            - self.y.fraction(values) * (self.height - self._TOP - self._BOTTOM)
        )

    def line(
        self,
        name: str,
        style: str,
        xs: Sequence[float] | NDArray[np.float64],
        ys: Sequence[float] | NDArray[np.float64],
    ) -> None:
        """Draw a line through xs, ys (n,) [units of the axes]; a longer one is cut. Raises nothing.

        name: for reading values; style: CSS class.
        """
        length = min(len(xs), len(ys))
        along, up = np.asarray(xs[:length], np.float64), np.asarray(ys[:length], np.float64)
        known = np.isfinite(along) & np.isfinite(up)
        if not known.any():
            return
        along, up = along[known], up[known]
        self._series.append((along, up))
        across, down = self.px(along), self.py(up)
        points = seen(across, down, _TOLERANCE)
        self._lines.append(
            f'<path class="ln {escape(style.strip())}" data-n="{escape(name)}" d="{_path(across[points], down[points])}"/>'
        )

    def band(self, low: float, high: float, style: str) -> None:
        """Shade an interval of x over the whole height."""
        self._bar(low, high, style, self._TOP, self.height - self._TOP - self._BOTTOM, 0.5)

    def strip(self, low: float, high: float, style: str) -> None:
        """Mark an interval of x by a thin bar above the plot."""
        self._bar(low, high, style, self._TOP - 6, 4, 1.0)

    def _bar(
        self, low: float, high: float, style: str, top: int, height: int, least: float
    ) -> None:
        left, wide = self.px(low), max(self.px(high) - self.px(low), least)
        self._under.append(
            f'<rect class="{escape(style)}" x="{left:.1f}" y="{top}" width="{wide:.1f}" height="{height}"/>'
        )

    def level(self, value: float, words: str) -> None:
        """Draw a horizontal line with its label."""
        y = self.py(value)
        ends = np.array([self.x.low, self.x.high])
        self._series.append((ends, np.full(2, value)))
        self._lines.append(
            f'<path class="level" data-n="{escape(words)}" d="M{self._LEFT},{y:.1f}H{self.width - self._RIGHT}"/>'
        )
        self._levels.append((y, words))

    def point(
        self,
        x: float,
        y: float,
        style: str,
        marker: str,
        tip: str,
        href: str = "",
        radius: float = 5.0,
        keeps_free: bool = True,
    ) -> None:
        """Draw a marker with focus; `tip` is read on hover and focus.

        radius: of a circle; keeps_free: no label may overlap.
        """
        left, top = self.px(x), self.py(y)
        shape = {
            "square": f'<rect x="{left - 4.5:.1f}" y="{top - 4.5:.1f}" width="9" height="9"/>',
            "diamond": f'<path d="M{left:.1f},{top - 6:.1f}l6,6l-6,6l-6,-6z"/>',
            "triangle": f'<path d="M{left:.1f},{top - 6:.1f}l6,10.5h-12z"/>',
        }.get(marker, f'<circle cx="{left:.1f}" cy="{top:.1f}" r="{radius:g}"/>')
        element, leads = ("a", f' href="{escape(href)}"') if href else ("g", "")
        self._over.append(
            f'<{element} class="pt {escape(style)}"{leads}><title>{escape(tip)}</title>{shape}</{element}>'
        )
        self._points.append((x, y))
        if keeps_free:
            self._taken.append(
                (left - radius - 1, top - radius - 1, left + radius + 1, top + radius + 1)
            )

    def label(
        self,
        x: float,
        y: float,
        words: str,
        style: str = "",
        *,
        anchor: str = "start",
        pixels: bool = False,
        shifts: Sequence[float] = _SHIFTS,
    ) -> bool:
        """Write words at a point, moved vertically past other labels; return False without room."""
        left, top = (x, y) if pixels else (self.px(x), self.py(y) - 5)
        wide = len(words) * (_BOLD if style == "strong" else _CHARACTER)
        start = left - {"start": 0.0, "middle": wide / 2, "end": wide}[anchor]
        start = min(max(start, self._LEFT + 2), self.width - 2 - wide)
        for shift in shifts:
            box = (start, top + shift - 11, start + wide, top + shift + 3)
            inside = box[1] >= self._TOP - 12 and box[3] <= self.height - self._BOTTOM + 2
            if inside and not any(_overlap(box, other) for other in self._taken):
                self._taken.append(box)
                self._over.append(
                    f'<text class="tag {escape(style)}" x="{start:.1f}" y="{top + shift:.1f}">{escape(words)}</text>'
                )
                return True
        return False

    def name_points(self, named: list[tuple[float, float, str]]) -> None:
        """Name points; of overlapping markers the first, and the number of others."""
        groups: list[tuple[float, float, list[str]]] = []
        for x, y, name in named:
            left, top = self.px(x), self.py(y)
            near = next(
                (names for gx, gy, names in groups if abs(gx - left) < 9 and abs(gy - top) < 9),
                None,
            )
            if near is None:
                groups.append((left, top, [name]))
            else:
                near.append(name)
        for left, top, names in groups:
            words = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
            for dx, dy, anchor in _PLACES:
                if self.label(
                    left + dx, top + dy, words, "strong", anchor=anchor, pixels=True, shifts=(0,)
                ):
                    break
            else:
                self.label(left + 9, top + 4, words, "strong", pixels=True)

    def markup(self, hidden: bool = True) -> Markup:
        """Return the SVG; without links it is hidden from assistive technology."""
        axes = {
            "x": [
                _short(self.x.low),
                _short(self.x.high),
                self._LEFT,
                self.width - self._RIGHT,
                int(self.x.log),
            ],
            "y": [
                _short(self.y.low),
                _short(self.y.high),
                self.height - self._BOTTOM,
                self._TOP,
                int(self.y.log),
            ],
            "q": [self.x.quantity, unit(self.x.unit), self.y.quantity, unit(self.y.unit)],
        }
        # Labels of levels come last, to avoid points and names, at the end that has room.
        for y, words in self._levels:
            for left, anchor in (
                (self.width - self._RIGHT - 2, "end"),
                (self._LEFT + 4, "start"),
                (self.width / 2, "middle"),
            ):
                if self.label(
                    left, y - 4, words, "small", anchor=anchor, pixels=True, shifts=(0, _LINE + 4)
                ):
                    break
        self._levels.clear()
        quiet = ' aria-hidden="true"' if hidden else ""
        inside = "".join([*self._under, *self._grid(), *self._lines, *self._over])
        # In single quotes, because JSON contains double ones.
        axes_json = (
            json.dumps(axes, separators=(",", ":"), ensure_ascii=False)
            .replace("&", "&amp;")
            .replace("<", "&lt;")
            .replace("'", "&#39;")
        )
        points = [tuple(np.array(self._points).T)] if self._points else []
        return Markup(
            f'<svg class="plot" viewBox="0 0 {self.width} {self.height}" data-axes=\'{axes_json}\' '
            f'data-v="{packed([*self._series, *points], self.x, self.y)}"{quiet}>{inside}</svg>'
        )

    def _grid(self) -> list[str]:
        bottom, right = self.height - self._BOTTOM, self.width - self._RIGHT
        across, up, below, left = [], [], [], []
        for value, label in self.x.ticks(max(3, int((right - self._LEFT) / 62))):
            x = _pixel(self.px(value))
            up.append(f"M{x},{self._TOP}V{bottom}")
            below.append(f'<text x="{x}" y="{bottom + 15}">{escape(label)}</text>')
        zero = ""
        for value, label in self.y.ticks(max(3, int((bottom - self._TOP) / 32))):
            y = self.py(value)
            line = f"M{self._LEFT},{_pixel(y)}H{right}"
            if value == 0:
                zero = f'<path class="grid zero" d="{line}"/>'
            else:
                across.append(line)
            left.append(f'<text x="{self._LEFT - 6}" y="{_pixel(y + 4)}">{escape(label)}</text>')
        return [
            f'<path class="grid x" d="{"".join(up)}"/><path class="grid" d="{"".join(across)}"/>{zero}',
            f'<g class="tick x">{"".join(below)}</g><g class="tick">{"".join(left)}</g>',
            f'<path class="frame" d="M{self._LEFT},{self._TOP}V{bottom}H{right}"/>',
            f'<text class="axis x" x="{right}" y="{self.height - 6}">{escape(self.x.title)}</text>',
            f'<text class="axis" x="2" y="12">{escape(self.y.title)}</text>',
        ]


# A line: name, CSS class, times [s] and values, which may be one shorter.
Line = tuple[str, str, NDArray[np.float64], NDArray[np.float64]]


def over_time(
    title: str,
    quantity: str,
    unit: str,
    lines: Sequence[Line],
    *,
    x: Axis | None = None,
    height: int = 240,
    **axis: Any,
) -> Plot | None:
    """Return lines over time on one axis, None without lines.

    x: axis of time, default all lines; axis: arguments of `Axis.fitted` for the values.
    """
    if not lines:
        return None
    along = x or Axis.fitted(
        "time", "s", [end for _, _, t, _ in lines for end in (t[0], t[-1])], margin=0.0
    )
    plot = Plot(
        title,
        along,
        Axis.fitted(quantity, unit, np.concatenate([values for *_, values in lines]), **axis),
        height=height,
    )
    for line in lines:
        plot.line(*line)
    return plot


def _pixel(place: float) -> str:
    return f"{place:.1f}".removesuffix(".0")


def _path(across: NDArray[np.float64], down: NDArray[np.float64]) -> str:
    """Return a path through points, relative, to a fifth of a pixel; signs separate numbers."""
    places = np.rint(5 * np.column_stack([across, down])).astype(int)
    steps = " ".join(_fifth(step) for step in np.diff(places, axis=0).ravel().tolist())
    return f"M{_fifth(int(places[0, 0]))},{_fifth(int(places[0, 1]))}l{steps.replace(' -', '-') or '0,0'}"


@lru_cache(maxsize=10_000)
def _fifth(place: int) -> str:
    return _pixel(place / 5).replace("0.", ".") if abs(place) < 5 else _pixel(place / 5)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _overlap(
    first: tuple[float, float, float, float], second: tuple[float, float, float, float]
) -> bool:
    return (
        first[0] < second[2]
        and second[0] < first[2]
        and first[1] < second[3]
        and second[1] < first[3]
    )
