"""What a plot shows, read back from its SVG: lines and points with their values, as the reader's script finds them."""

import base64
import html
import re
import zlib
from dataclasses import dataclass

import numpy as np

from reports.plots import Axis, Plot

_MARKERS = {
    "circle": "circle",
    "rect": "square",
    "l6,6l-6,6l-6,-6z": "diamond",
    "l6,10.5h-12z": "triangle",
}
Place = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """A marker: CSS class, kind, tip, where it leads, and its values."""

    style: str
    marker: str
    tip: str
    link: str
    at: Place


@dataclass(frozen=True)
class Drawn:
    """lines: name -> (CSS class, values); marks in their order.

    tags: (CSS class, words) of the labels that had room.
    """

    lines: dict[str, tuple[str, list[Place]]]
    marks: list[Mark]
    tags: list[tuple[str, str]]


def unpacked(text: str, x: Axis, y: Axis) -> list[tuple[np.ndarray, np.ndarray]]:
    """The series of a plot, by the format as it is written down."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    flat = [
        int(value) for value in np.ascontiguousarray(planes.reshape(8, -1).T).view("<u8").ravel()
    ]
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


def drawn(plot: Plot) -> Drawn:
    """Values to four digits."""
    svg = str(plot.markup(hidden=False))
    found = re.search(r'data-v="([^"]*)"', svg)
    assert found is not None
    places = [
        [(float(f"{x:.4g}"), float(f"{y:.4g}")) for x, y in zip(*one, strict=True)]
        for one in unpacked(html.unescape(found[1]), plot.x, plot.y)
    ]
    lines = re.findall(r'<path class="(?:ln )?([^"]*)" data-n="([^"]*)"', svg)
    marks = re.findall(
        r'<(?:a|g) class="pt ([^"]*)"(?: href="([^"]*)")?><title>(.*?)</title><(\w+)(?: d="M[-\d.]+,[-\d.]+(\S+?)")?',
        svg,
    )
    of_marks = places[len(lines)] if marks else []
    return Drawn(
        {
            html.unescape(name): (style, values)
            for (style, name), values in zip(lines, places, strict=False)
        },
        [
            Mark(style, _MARKERS[path or shape], html.unescape(tip), html.unescape(link), at)
            for (style, link, tip, shape, path), at in zip(marks, of_marks, strict=True)
        ],
        [
            (style, html.unescape(words))
            for style, words in re.findall(r'<text class="tag ([^"]*)"[^>]*>(.*?)</text>', svg)
        ],
    )
