"""Is there a piece of the linearised problem - every biactive pair decided - in which a direction goes down?

Where programs are small all pieces are looked at, for the steepest slope. Where they are large a tree of decisions is searched: a pair that is not decided yet
asks only that neither side goes below 0, which holds in both its pieces. If no direction goes down there, none does in any piece below; if one does
and happens to leave one side of each pair at 0, it lies in a piece; else the pair that both sides of leave is decided.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from formulations.mpec.certificate.active import ActiveSet
from formulations.mpec.certificate.decision import decide
from formulations.mpec.certificate.multipliers import column_lengths
from formulations.mpec.certificate.programs import steepest_direction
from formulations.mpec.certificate.signs import limits

# Linear programs for one question at most: 2^10 pieces where programs are small, fewer where they are large.
_MOST, _TIMES_VARIABLES = 1024, 200_000
# Up to this many variables all pieces are looked at; nodes of a tree that is too large to be searched to its end.
_SMALL, _FEW = 400, 12
# A side that rises by less along a direction of largest component 1 stays where it is (HiGHS holds a row to 1e-7).
_STAYS = 1e-7
_UNDECIDED, _FIRST, _SECOND = 0, 1, 2
_SIGNS = {_UNDECIDED: (">", ">"), _FIRST: ("*", ">"), _SECOND: (">", "*")}


def affordable(active: ActiveSet, choices: int) -> int:
    """How many nodes of a tree with so many choices for each biactive pair may be looked at: all where that costs little."""
    leaves = choices ** len(active.both)
    most = min(_MOST, max(8, _TIMES_VARIABLES // max(1, len(active.gradient))))
    return 2 * leaves if leaves <= most else _FEW


def steepest_piece(active: ActiveSet, tolerance: float) -> tuple[float, np.ndarray | None]:
    """(smallest gradient' d found over |d| <= 1 and all pieces, relative to the scale; d): B-stationary where it is 0. NaN if there are too
    many pieces to look at all of them, or a program failed, and those looked at have no descent beyond the tolerance."""
    if len(active.gradient) <= _SMALL and 2 ** len(active.both) <= _MOST:
        return _every_piece(active)
    stack, complete = [np.full(len(active.both), _UNDECIDED)], True
    for _ in range(affordable(active, 2)):
        if not stack:
            break
        node = stack.pop()
        slope, direction = _down(active, node, tolerance)
        if direction is None:
            complete = complete and not math.isnan(slope)
            continue
        sides = (side[:, active.both] for side in (active.first_normals, active.second_normals))
        first, second = (side.T @ direction / column_lengths(side) for side in sides)
        both_rise = np.where(node == _UNDECIDED, np.minimum(first, second), 0.0)
        pair = int(np.argmax(both_rise)) if len(node) else 0
        if not len(node) or both_rise[pair] <= _STAYS:
            return slope, direction
        for decision in (_FIRST, _SECOND) if first[pair] > second[pair] else (_SECOND, _FIRST):  # the side that rises less is held first
            child = node.copy()
            child[pair] = decision
            stack.append(child)
    return (0.0, None) if complete and not stack else (math.nan, None)


def _down(active: ActiveSet, node: np.ndarray, tolerance: float) -> tuple[float, np.ndarray | None]:
    """(slope, a direction that goes down by more than the tolerance, or None): below this node. NaN and None where it is not known."""
    found = decide(active.matrix, active.gradient / active.scale, *limits(active, [_SIGNS[int(k)] for k in node]), tolerance)
    if found.polar is not None:
        return found.slope, -found.polar / np.max(np.abs(found.polar))
    # no direction falls by more than what multipliers leave in all
    if found.exists and found.total <= tolerance:
        return 0.0, None
    slope, direction = steepest_direction(active, node == _FIRST, node == _SECOND)
    return (slope, direction if slope < -tolerance else None)


def _every_piece(active: ActiveSet) -> tuple[float, np.ndarray | None]:
    best, direction, complete = 0.0, None, True
    for piece in itertools.product(*((True,) if same else (True, False) for same in _same_sides(active))):
        held = np.array(piece, dtype=bool)
        slope, d = steepest_direction(active, held, ~held)
        complete = complete and not math.isnan(slope)
        if slope < best:
            best, direction = slope, d
    return (math.nan, None) if direction is None and not complete else (best, direction)


def _same_sides(active: ActiveSet) -> list[bool]:
    """For each biactive pair, whether both sides have the same gradient (0 <= y complements y >= 0): then its two pieces are one."""
    difference = (active.first_normals - active.second_normals).tocsc()[:, active.both]
    return [float(np.max(np.abs(difference[:, k].data), initial=0.0)) <= 1e-12 for k in range(len(active.both))]
