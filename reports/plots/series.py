"""What a plot keeps of its series: the points of a line that can be seen, and the numbers of all, as text that its page holds.

seen(across, down, 0.25) -> [0, 7, 12, ..]        packed([(t, force), (t, planned)], x, y) -> "eJxj.."

Readers save the numbers, zoom, and read values off. A column is whole numbers of a decimal grain, so that 0.01 s stays 0.01 s; of those, second differences, which are small for smooth motions; of those,
the first bytes of all, then the second ones, .., which zlib makes short: 105,000 numbers of the longest page of a run are 44 kB (as JSON of five digits,
compressed: 311 kB). The script's `unpacked` reads it.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from reports.plots.axis import Axis

# Grains are powers of ten, of a linear axis at most such a share. Of y a finer one takes half as much room again; of x, mostly equal steps, it does not,
# and neighbours of 1,500 times must be told apart. Of a decade of a logarithmic axis: five digits.
_OF_X, _OF_Y, _OF_DECADE = -6, -4, -5
# Whole numbers up to ten to this are exact in the script, and so are their second differences.
_DIGITS = 14
# The logarithm of what is no positive number: a value that no plot shows.
_SMALLEST = 1e-200
# Stretches of so many points are looked at all at once; of the tolerance, this share is theirs.
_STRETCH, _STRAIGHT = 8, 0.1

Array = NDArray[np.float64]


def packed(series: Sequence[tuple[Array, Array]], x: Axis, y: Axis) -> str:
    """The series of a plot.

    Parameters
    ----------
    series : of each, (n,) values in the unit of x and (n,) in that of y, all finite
    x, y : the axes it is drawn on

    Returns
    -------
    text : base64 of a zlib stream of 64 bit integers, a byte of each after the other. First the number of series, then of each the count and the
        exponent of x (count 0: those of the series before) and the same of y, then the second differences of all columns.
    """
    heads, steps = [len(series)], []
    before = np.zeros(0)
    for xs, ys in series:
        for values, axis, fine in ((xs[:0] if np.array_equal(before, xs) else xs, x, _OF_X), (ys, y, _OF_Y)):
            exponent, grains = _grains(values, axis, fine)
            heads += [len(grains), exponent]
            steps.append(np.diff(grains, 2, prepend=[0, 0]))
        before = xs
    flat = np.concatenate([heads, *steps]).astype("<i8")
    unsigned = (flat << 1) ^ (flat >> 63)
    return base64.b64encode(zlib.compress(unsigned.view(np.uint8).reshape(-1, 8).T.tobytes(), 9)).decode()


def _grains(values: Array, axis: Axis, fine: int) -> tuple[int, NDArray[np.int64]]:
    """The power of ten of a column's grain, and the column in grains: of its decimal logarithm where the axis is logarithmic."""
    if axis.log:
        return _OF_DECADE, np.rint(np.log10(np.maximum(values, _SMALLEST)) / 10.0**_OF_DECADE).astype(np.int64)
    largest = float(np.abs(values).max(initial=axis.high - axis.low))
    exponent = max(math.floor(math.log10(axis.high - axis.low)) + fine, math.ceil(math.log10(largest)) - _DIGITS)
    return exponent, np.rint(values / 10.0**exponent).astype(np.int64)


def seen(xs: NDArray[np.float64], ys: NDArray[np.float64], tolerance: float) -> list[int]:
    """The points that are kept: every other lies at most `tolerance` above or below what is drawn.

    A cone of slopes from the last kept point narrows with each point; the point before it closes is kept.

    Parameters
    ----------
    xs : (n,) [pixel], not decreasing
    ys : (n,) [pixel]
    tolerance : [pixel]

    Returns
    -------
    indices : (k,) [-], with the first and the last
    """
    if len(xs) < 3:
        return list(range(len(xs)))
    places = _bent(xs, ys, _STRAIGHT * tolerance)
    tolerance *= 1 - _STRAIGHT
    kept = [0]
    points = zip(places.tolist(), xs[places].tolist(), ys[places].tolist(), strict=True)
    previous, previous_x, previous_y = next(points)
    anchor_x, anchor_y = previous_x, previous_y
    low, high = -inf, inf
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
            low, high = -inf, inf
        previous, previous_x, previous_y = place, x, y
    if previous != kept[-1]:
        kept.append(previous)
    return kept


def _bent(xs: NDArray[np.float64], ys: NDArray[np.float64], tolerance: float) -> NDArray[np.int64]:
    """Numbers of the points without those inside stretches that are straight to `tolerance`: most of what is drawn is smooth, or level."""
    ends = np.arange(0, len(xs) - _STRETCH, _STRETCH)
    run, rise = xs[ends + _STRETCH] - xs[ends], ys[ends + _STRETCH] - ys[ends]
    slope = rise / np.where(run > 0, run, 1.0)
    inside = ends[:, None] + np.arange(1, _STRETCH)
    away = np.abs(ys[inside] - ys[ends, None] - slope[:, None] * (xs[inside] - xs[ends, None]))
    bent = np.ones(len(xs), bool)
    bent[inside[(away.max(axis=1, initial=0.0) <= tolerance) & (run > 0)]] = False
    return np.flatnonzero(bent)
