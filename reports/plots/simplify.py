"""Leaves out the points of a line that nobody can see: fewer bytes, the same picture."""

from __future__ import annotations


def simplified(points: list[tuple[float, float]], tolerance: float) -> list[tuple[float, float]]:
    """The line with every dropped point at most `tolerance` above or below what is drawn. x must not decrease.

    A cone of slopes from the last kept point narrows with each point; the point before it closes is kept.
    """
    if len(points) < 3:
        return points
    kept = [points[0]]
    anchor_x, anchor_y = points[0]
    low, high = float("-inf"), float("inf")
    previous = points[0]
    for point in points[1:]:
        run = point[0] - anchor_x
        if run > 1e-9:
            slope = (point[1] - anchor_y) / run
            if low <= slope <= high:
                low, high = max(low, slope - tolerance / run), min(high, slope + tolerance / run)
                previous = point
                continue
        elif abs(point[1] - previous[1]) <= tolerance:
            continue
        if previous != kept[-1]:
            kept.append(previous)
        anchor_x, anchor_y = previous
        run = point[0] - anchor_x
        if run > 1e-9:
            slope = (point[1] - anchor_y) / run
            low, high = slope - tolerance / run, slope + tolerance / run
        else:
            kept.append(point)
            anchor_x, anchor_y = point
            low, high = float("-inf"), float("inf")
        previous = point
    if previous != kept[-1]:
        kept.append(previous)
    return kept
