"""Where a contact acts on the drawn bodies: the two shapes, and the points of them, whose distance changes exactly as the contact's gap does.

A record holds how bodies are drawn and how wide each contact's gap is, but not which bodies touch. What they are drawn as tells it: the gap of two
carts is the distance of two boxes less a constant, that of a fingertip the distance of a line's end from a disc's centre less a radius. A pair is
taken only if that constant is one, to a thousandth of the gap's range; a contact without such a pair has no arrows, only its bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from reports.record import ShapeRecord, TraceRecord
from reports.series import array_of
from reports.traces import gap

_SHARE = 1e-3
# Poses looked at, evenly over the trace: a wrong pair does not fit so many by chance.
_LOOKS = 40

Points = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Touch:
    """Shapes by their numbers, and the point of each along its own length (0 centre, -0.5 and 0.5 the ends of a line); flat: the second is a
    face, and the force on the first acts along its normal, turned from the shape's own direction by `turn` [rad]."""

    first: int
    second: int
    first_end: float
    second_end: float
    flat: bool
    turn: float = 0.0


def touches(shapes: Sequence[ShapeRecord], trace: TraceRecord | None, contact: str) -> Touch | None:
    """The pair for a contact of this trace, the best that fits; None if none does."""
    values = gap(trace, contact)
    if trace is None or values is None:
        return None
    places = _places(min(len(values), len(trace.t)))
    gaps = array_of(values)[places]
    span = float(np.ptp(gaps))
    if span <= 0:
        return None
    poses = [trace.poses.get(shape.name) for shape in shapes]
    if any(one is not None and len(one) <= places[-1] for one in poses):
        return None
    seen = [array_of(one)[places].T if one else None for one in poses]

    @cache
    def points(shape: int, end: float) -> Points | None:
        """Where a point of a shape is at every look, if its poses are known."""
        poses = seen[shape]
        if poses is None:
            return None
        x, y, angle = poses
        return x + end * shapes[shape].size[0] * np.cos(angle), y + end * shapes[shape].size[0] * np.sin(angle)

    best: tuple[float, Touch] | None = None
    for touch in _candidates(shapes):
        first, second, face = points(touch.first, touch.first_end), points(touch.second, touch.second_end), seen[touch.second]
        if first is None or second is None or face is None:
            continue
        apart = _distance(touch, first, second, face[2])
        spread = float(np.ptp(gaps - apart))
        if spread <= _SHARE * span and (best is None or spread < best[0] - 1e-12):
            best = (spread, touch)
    return best[1] if best else None


def _places(length: int) -> list[int]:
    return sorted({round(part * (length - 1) / (_LOOKS - 1)) for part in range(_LOOKS)})


def _candidates(shapes: Sequence[ShapeRecord]) -> Iterator[Touch]:
    """Simplest first: of two that fit alike the earlier is taken."""
    for first, one in enumerate(shapes):
        for second, other in enumerate(shapes):
            if first == second:
                continue
            for end in _ends(one):
                if not _round(other):
                    for quarter in (1, -1, 0, 2) if other.kind == "box" else (1, -1):
                        yield Touch(first, second, end, 0.0, True, quarter * math.pi / 2)
                if first < second or not _round(one):
                    yield from (Touch(first, second, end, far, False) for far in _ends(other))


def _round(shape: ShapeRecord) -> bool:
    return shape.kind == "disc"


def _ends(shape: ShapeRecord) -> tuple[float, ...]:
    return (0.0, -0.5, 0.5) if shape.kind in ("line", "wall") else (0.0,)


def _distance(touch: Touch, first: Points, second: Points, angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Between the points; from a face, whose shape is turned by `angle`, along its normal."""
    across, up = first[0] - second[0], first[1] - second[1]
    if touch.flat:
        return across * np.cos(angle + touch.turn) + up * np.sin(angle + touch.turn)
    return np.hypot(across, up)
