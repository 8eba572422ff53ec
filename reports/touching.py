"""Where a contact acts on the drawn bodies: the two shapes, and the points of them, whose distance changes exactly as the contact's gap does.

A record holds how bodies are drawn and how wide each contact's gap is, but not which bodies touch. What they are drawn as tells it: the gap of two
carts is the distance of two boxes less a constant, that of a fingertip the distance of a line's end from a disc's centre less a radius. A pair is
taken only if that constant is one, to a thousandth of the gap's range; a contact without such a pair has no arrows, only its bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from reports.record import ShapeRecord, TraceRecord
from reports.traces import gap

_SHARE = 1e-3
# Poses looked at, evenly over the trace: a wrong pair does not fit so many by chance.
_LOOKS = 40

Point = tuple[float, float]
Pose = tuple[float, float, float]


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
    gaps = [values[place] for place in places]
    span = max(gaps) - min(gaps)
    if span <= 0:
        return None
    poses = [trace.poses.get(shape.name) for shape in shapes]
    if any(one is not None and len(one) <= places[-1] for one in poses):
        return None
    seen = [[one[place] for place in places] if one else None for one in poses]
    best: tuple[float, Touch] | None = None
    for touch in _candidates(shapes):
        first, second = seen[touch.first], seen[touch.second]
        if first is None or second is None:
            continue
        rests = [width - _distance(shapes, touch, one, other) for width, one, other in zip(gaps, first, second, strict=True)]
        spread = max(rests) - min(rests)
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


def _point(shape: ShapeRecord, end: float, pose: Pose) -> Point:
    x, y, angle = pose
    return x + end * shape.size[0] * math.cos(angle), y + end * shape.size[0] * math.sin(angle)


def _distance(shapes: Sequence[ShapeRecord], touch: Touch, first: Pose, second: Pose) -> float:
    ax, ay = _point(shapes[touch.first], touch.first_end, first)
    bx, by = _point(shapes[touch.second], touch.second_end, second)
    if touch.flat:
        angle = second[2] + touch.turn
        return (ax - bx) * math.cos(angle) + (ay - by) * math.sin(angle)
    return math.hypot(ax - bx, ay - by)
