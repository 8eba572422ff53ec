"""Leaves out the points of a line that nobody can see: fewer bytes, the same picture."""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reports.series import array_of


def seen(xs: NDArray[np.float64], ys: NDArray[np.float64], tolerance: float) -> list[int]:
    """Numbers of the points that are kept: every other lies at most `tolerance` above or below what is drawn. x must not decrease.

    A cone of slopes from the last kept point narrows with each point; the point before it closes is kept.
    """
    if len(xs) < 3:
        return list(range(len(xs)))
    # Inside a level stretch nothing changes the cone but its end: forces are zero for most of the time.
    level = ys[1:] == ys[:-1]
    places = np.flatnonzero(~np.concatenate(([False], level[1:] & level[:-1], [False])))
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


def simplified(points: ArrayLike, tolerance: float) -> list[tuple[float, float]]:
    """The points (x, y) of a line that are kept."""
    xs, ys = array_of(np.asarray(points, np.float64)).reshape(-1, 2).T
    places = seen(xs, ys, tolerance)
    return list(zip(xs[places].tolist(), ys[places].tolist(), strict=True))
