"""The numbers of a plot as text that its page holds: every point of every series, so that a reader can save them, zoom, and read values off.

packed([(t, force), (t, planned)], x, y) -> "eJxj.."

A column is whole numbers of a decimal grain, so that 0.01 s stays 0.01 s; of those, second differences, which are small for smooth motions; of those,
the first bytes of all, then the second ones, .., which zlib makes short: 105,000 numbers of the longest page of a run are 44 kB (as JSON of five digits,
compressed: 311 kB). The script's `unpacked` reads it.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence

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
