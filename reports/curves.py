"""Curves of a sweep: read off where one reaches a value, on logarithmic scales."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise


def reached(points: Iterable[tuple[float, float]], goal: float) -> float | None:
    """The largest setting from which on downwards the error stays at or below `goal`: (setting, error), linear in the logarithms.

    None if even the smallest setting is above; the largest setting if none is.
    """
    ordered = sorted(points)
    if not ordered or ordered[0][1] > goal:
        return None
    for (below, small), (above, large) in pairwise(ordered):
        if large > goal:
            part = math.log(goal / small) / math.log(large / small) if small > 0 else 0.0
            return below * (above / below) ** part
    return ordered[-1][0]


def at(points: Iterable[tuple[float, float]], setting: float) -> float | None:
    """The error at a setting between those measured; None outside, or where a neighbour is zero."""
    ordered = sorted(points)
    for (below, small), (above, large) in pairwise(ordered):
        if below <= setting <= above and small > 0 and large > 0:
            part = math.log(setting / below) / math.log(above / below)
            return small * (large / small) ** part
    return None
