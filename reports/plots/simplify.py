"""Leaves out the points of a line that nobody can see: fewer bytes, the same picture."""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

# Stretches of so many points are looked at all at once; of the tolerance, this share is theirs.
_STRETCH, _STRAIGHT = 8, 0.1


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
