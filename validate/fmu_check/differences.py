"""Jacobians of an FMU by finite differences that know their own error.

Central differences with steps h, h/4, ... (Ridders, Accurate computation of F'(x), Adv. Eng. Software 4, 1982): two neighbours are extrapolated, and the
pair that changes least is taken. What the two one-sided differences do not agree on, however small the step, is a kink: no derivative is there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Steps: from this share of the variable's size, each a quarter of the one before.
_LARGEST, _COUNT = 1e-2, 9
# Rounding of one evaluation, in units of the last place of its value.
_ULPS = 16.0
# Derivatives that an FMU computes by differences itself are this far off, and are none the worse for their users; wrong ones are farther.
_SHARE = 1e-3
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Column:
    """d(unknowns)/d(one known): value, error estimate and where there is no derivative, each (unknowns,)."""

    value: np.ndarray
    error: np.ndarray
    kink: np.ndarray


def column(evaluate: Callable[[np.ndarray], np.ndarray], x: np.ndarray, place: int, size: float, largest: float = _LARGEST) -> Column:
    """The column of entry `place` of x at x; size: the typical magnitude of that entry."""
    middle = evaluate(x)
    central, forward, backward, noise = [], [], [], []
    for number in range(_COUNT):
        step = max(size, abs(x[place])) * largest / 4.0**number
        above, below = x.copy(), x.copy()
        above[place] += step
        below[place] -= step
        up, down = evaluate(above), evaluate(below)
        right, left = above[place] - x[place], x[place] - below[place]
        central.append((up - down) / (right + left))
        forward.append((up - middle) / right)
        backward.append((middle - down) / left)
        noise.append(_ULPS * _EPS * np.maximum(np.maximum(np.abs(up), np.abs(down)), np.abs(middle)) / step)
    d, rounding = np.array(central), np.array(noise)
    extrapolated = (16.0 * d[1:] - d[:-1]) / 15.0
    error = np.abs(extrapolated[1:] - extrapolated[:-1]) + 2.0 * rounding[2:]
    error = np.where(np.isfinite(error), error, np.inf)
    best = np.argmin(error, axis=0)
    columns = np.arange(d.shape[1])
    gap = np.abs(np.array(forward) - np.array(backward))
    # A smooth function's one-sided differences approach each other as the step; four times smaller, four times nearer.
    here, before = gap[best + 2, columns], gap[best + 1, columns]
    kink = (here > 0.5 * before) & (here > 10.0 * rounding[best + 2, columns])
    return Column(extrapolated[best + 1, columns], error[best, columns], kink)


def rounding_of(claimed: np.ndarray) -> float:
    """What large terms that cancel leave of an entry that is zero: some units in the last place of the largest entry."""
    return _ULPS * _EPS * float(np.abs(claimed[np.isfinite(claimed)]).max(initial=0.0))


def agrees(claimed: np.ndarray, found: Column) -> np.ndarray:
    """(unknowns,) whether a claimed column is within the error of the one found; True where nothing can be said."""
    allowed = 10.0 * found.error + _SHARE * np.maximum(np.abs(claimed), np.abs(found.value)) + rounding_of(claimed)
    return (np.abs(claimed - found.value) <= allowed) | found.kink | ~np.isfinite(found.error)


def resolved(claimed: np.ndarray, found: Column) -> np.ndarray:
    """(unknowns,) whether an error of a thousandth of the entry would show."""
    size = np.maximum(np.abs(claimed), np.abs(found.value))
    return ~found.kink & ((found.error <= 1e-3 * size) | (np.abs(claimed - found.value) <= found.error))
