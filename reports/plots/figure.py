"""One plot: lines, points, bands and labels on two axes, as SVG.

    plot = Plot("Contact force", Axis.fitted("time", "s", t), Axis.fitted("force", "N", force))
    plot.line("plan", "p", t, force);  plot.markup()

Colours are CSS classes, never attributes, so that the page's light, dark and print styles decide. Beside what is drawn stand the numbers of every
series (reports.plots.series), for reading values, zooming and saving.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from reports.plots.axis import Axis
from reports.plots.series import packed, seen
from reports.wording import unit

# Less than half a pixel: no point that is left out lies farther from the line that is drawn, and peaks and jumps are points that stay.
_TOLERANCE = 0.4
# Digits of the axes' ends, by which the script finds the pixels of values.
_DIGITS = 7
# Width of a character of the 12 px font, plain and bold, for keeping labels apart; a little too wide rather than too narrow.
_CHARACTER, _BOLD, _LINE = 6.6, 7.8, 14.0
_SHIFTS = (0, -_LINE, _LINE, -2 * _LINE, 2 * _LINE, -3 * _LINE, 3 * _LINE)


@dataclass(frozen=True)
class Key:
    """One entry of a legend: CSS class of the line or marker, and words."""

    style: str
    words: str
    marker: str = ""


@dataclass
class Plot:
    """`words`: what the plot shows, as a sentence for those who do not see it."""

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

    _LEFT, _RIGHT, _TOP, _BOTTOM = 54, 14, 26, 38

    def px(self, value: float) -> float:
        """The pixel of a value of x, from the left."""
        return self._LEFT + self.x.fraction(value) * (self.width - self._LEFT - self._RIGHT)

    def py(self, value: float) -> float:
        """The pixel of a value of y, from the top."""
        return self.height - self._BOTTOM - self.y.fraction(value) * (self.height - self._TOP - self._BOTTOM)

    def line(self, name: str, style: str, xs: Sequence[float] | NDArray[np.float64], ys: Sequence[float] | NDArray[np.float64]) -> None:
        """Draw a line.

        Parameters
        ----------
        name, style : words for reading values back, CSS class
        xs, ys : (n,), in the units of the axes; the shorter decides, as quantities of steps are one shorter than those of nodes
        """
        length = min(len(xs), len(ys))
        along, up = np.asarray(xs[:length], np.float64), np.asarray(ys[:length], np.float64)
        known = np.isfinite(along) & np.isfinite(up)
        if not known.any():
            return
        along, up = along[known], up[known]
        self._series.append((along, up))
        across = self.x.pixels(along, self._LEFT, self.width - self._RIGHT)
        down = self.y.pixels(up, self.height - self._BOTTOM, self._TOP)
        points = seen(across, down, _TOLERANCE)
        self._lines.append(f'<path class="ln {escape(style.strip())}" data-n="{escape(name)}" d="{_path(across[points], down[points])}"/>')

    def band(self, low: float, high: float, style: str) -> None:
        """An interval of x, shaded over the whole height."""
        left, right = self.px(low), self.px(high)
        height = self.height - self._TOP - self._BOTTOM
        self._under.append(
            f'<rect class="{escape(style)}" x="{left:.1f}" y="{self._TOP}" width="{max(right - left, 0.5):.1f}" height="{height}"/>'
        )

    def strip(self, low: float, high: float, style: str, level: int) -> None:
        """An interval of x as a thin bar above the plot, level 0 lowest."""
        left, right = self.px(low), self.px(high)
        top = self._TOP - 6 - 6 * level
        self._under.append(f'<rect class="{escape(style)}" x="{left:.1f}" y="{top}" width="{max(right - left, 1.0):.1f}" height="4"/>')

    def level(self, value: float, words: str) -> None:
        """A horizontal line with its label."""
        y = self.py(value)
        ends = np.array([self.x.low, self.x.high])
        self._series.append((ends, np.full(2, value)))
        self._lines.append(f'<path class="level" data-n="{escape(words)}" d="M{self._LEFT},{y:.1f}H{self.width - self._RIGHT}"/>')
        self._levels.append((y, words))

    def point(
        self, x: float, y: float, style: str, marker: str, tip: str, href: str = "", radius: float = 5.0, keeps_free: bool = True
    ) -> None:
        """A marker that can be focused: `tip` is its name and is read out on hover and focus. radius: of a circle; keeps_free: no label may lie on it."""
        left, top = self.px(x), self.py(y)
        shape = {
            "square": f'<rect x="{left - 4.5:.1f}" y="{top - 4.5:.1f}" width="9" height="9"/>',
            "diamond": f'<path d="M{left:.1f},{top - 6:.1f}l6,6l-6,6l-6,-6z"/>',
            "triangle": f'<path d="M{left:.1f},{top - 6:.1f}l6,10.5h-12z"/>',
        }.get(marker, f'<circle cx="{left:.1f}" cy="{top:.1f}" r="{radius:g}"/>')
        element, leads = ("a", f' href="{escape(href)}"') if href else ("g", "")
        self._over.append(f'<{element} class="pt {escape(style)}"{leads}><title>{escape(tip)}</title>{shape}</{element}>')
        self._points.append((x, y))
        if keeps_free:
            self._taken.append((left - radius - 1, top - radius - 1, left + radius + 1, top + radius + 1))

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
        """Words at a point of the plot, moved up or down past other labels; left out (False) if there is no room."""
        left, top = (x, y) if pixels else (self.px(x), self.py(y) - 5)
        wide = len(words) * (_BOLD if style == "strong" else _CHARACTER)
        start = left - {"start": 0.0, "middle": wide / 2, "end": wide}[anchor]
        start = min(max(start, self._LEFT + 2), self.width - 2 - wide)
        for shift in shifts:
            box = (start, top + shift - 11, start + wide, top + shift + 3)
            inside = box[1] >= self._TOP - 12 and box[3] <= self.height - self._BOTTOM + 2
            if inside and not any(_overlap(box, other) for other in self._taken):
                self._taken.append(box)
                self._over.append(f'<text class="tag {escape(style)}" x="{start:.1f}" y="{top + shift:.1f}">{escape(words)}</text>')
                return True
        return False

    def name_points(self, named: list[tuple[float, float, str]]) -> None:
        """Names beside points; of points closer than their markers the first is named, and how many more there are."""
        groups: list[tuple[float, float, list[str]]] = []
        for x, y, name in named:
            left, top = self.px(x), self.py(y)
            near = next((names for gx, gy, names in groups if abs(gx - left) < 9 and abs(gy - top) < 9), None)
            if near is None:
                groups.append((left, top, [name]))
            else:
                near.append(name)
        for left, top, names in groups:
            words = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
            for dx, dy, anchor in (
                (7, -6, "start"),
                (9, 4, "start"),
                (0, -10, "middle"),
                (0, 19, "middle"),
                (-9, 4, "end"),
                (7, 16, "start"),
            ):
                if self.label(left + dx, top + dy, words, "strong", anchor=anchor, pixels=True, shifts=(0,)):
                    break
            else:
                self.label(left + 9, top + 4, words, "strong", pixels=True)

    def markup(self, hidden: bool = True) -> Markup:
        """The SVG; hidden from assistive technology unless it holds links, because the figure around it says everything in words."""
        axes = {
            "x": [_short(self.x.low), _short(self.x.high), self._LEFT, self.width - self._RIGHT, int(self.x.log)],
            "y": [_short(self.y.low), _short(self.y.high), self.height - self._BOTTOM, self._TOP, int(self.y.log)],
            "q": [self.x.quantity, unit(self.x.unit), self.y.quantity, unit(self.y.unit)],
        }
        # Last, so that they keep clear of points and names: words of levels, at whichever end has room.
        for y, words in self._levels:
            for left, anchor in ((self.width - self._RIGHT - 2, "end"), (self._LEFT + 4, "start"), (self.width / 2, "middle")):
                if self.label(left, y - 4, words, "small", anchor=anchor, pixels=True, shifts=(0, _LINE + 4)):
                    break
        self._levels.clear()
        quiet = ' aria-hidden="true"' if hidden else ""
        inside = "".join([*self._under, *self._grid(), *self._lines, *self._over])
        # In single quotes, since JSON is full of double ones.
        told = json.dumps(axes, separators=(",", ":"), ensure_ascii=False).replace("&", "&amp;").replace("<", "&lt;").replace("'", "&#39;")
        points = [tuple(np.array(self._points).T)] if self._points else []
        return Markup(
            f'<svg class="plot" viewBox="0 0 {self.width} {self.height}" data-axes=\'{told}\' '
            f'data-v="{packed([*self._series, *points], self.x, self.y)}"{quiet}>{inside}</svg>'
        )

    def _grid(self) -> list[str]:
        bottom, right = self.height - self._BOTTOM, self.width - self._RIGHT
        across, up, below, left = [], [], [], []
        for value, said in self.x.ticks(max(3, int((right - self._LEFT) / 62))):
            x = _pixel(self.px(value))
            up.append(f"M{x},{self._TOP}V{bottom}")
            below.append(f'<text x="{x}" y="{bottom + 15}">{escape(said)}</text>')
        zero = ""
        for value, said in self.y.ticks(max(3, int((bottom - self._TOP) / 32))):
            y = self.py(value)
            line = f"M{self._LEFT},{_pixel(y)}H{right}"
            if value == 0:
                zero = f'<path class="grid zero" d="{line}"/>'
            else:
                across.append(line)
            left.append(f'<text x="{self._LEFT - 6}" y="{_pixel(y + 4)}">{escape(said)}</text>')
        return [
            f'<path class="grid x" d="{"".join(up)}"/><path class="grid" d="{"".join(across)}"/>{zero}',
            f'<g class="tick x">{"".join(below)}</g><g class="tick">{"".join(left)}</g>',
            f'<path class="frame" d="M{self._LEFT},{self._TOP}V{bottom}H{right}"/>',
            f'<text class="axis x" x="{right}" y="{self.height - 6}">{escape(self.x.title)}</text>',
            f'<text class="axis" x="2" y="12">{escape(self.y.title)}</text>',
        ]


# A line: its name, its CSS class, times [s] and values, which may be one shorter.
Line = tuple[str, str, NDArray[np.float64], NDArray[np.float64]]


def over_time(
    title: str, quantity: str, unit: str, lines: Sequence[Line], *, x: Axis | None = None, height: int = 240, **axis: Any
) -> Plot | None:
    """Lines over time on one axis; None where there are none. x: of the time (what the lines cover); axis: words of `Axis.fitted` for the values."""
    if not lines:
        return None
    along = x or Axis.fitted("time", "s", [end for _, _, t, _ in lines for end in (t[0], t[-1])], margin=0.0)
    plot = Plot(title, along, Axis.fitted(quantity, unit, np.concatenate([values for *_, values in lines]), **axis), height=height)
    for line in lines:
        plot.line(*line)
    return plot


def _pixel(place: float) -> str:
    """A place to a tenth of a pixel, without a needless zero."""
    return f"{place:.1f}".removesuffix(".0")


def _path(across: NDArray[np.float64], down: NDArray[np.float64]) -> str:
    """A line through points, each relative to the one before; to a fifth of a pixel, which is finer than what was left out. A sign parts numbers by itself."""
    places = np.rint(5 * np.column_stack([across, down])).astype(int)
    steps = " ".join(_fifth(step) for step in np.diff(places, axis=0).ravel().tolist())
    return f"M{_fifth(int(places[0, 0]))},{_fifth(int(places[0, 1]))}l{steps.replace(' -', '-') or '0,0'}"


@lru_cache(maxsize=10_000)
def _fifth(place: int) -> str:
    return _pixel(place / 5).replace("0.", ".") if abs(place) < 5 else _pixel(place / 5)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _overlap(first: tuple[float, float, float, float], second: tuple[float, float, float, float]) -> bool:
    return first[0] < second[2] and second[0] < first[2] and first[1] < second[3] and second[1] < first[3]
