"""The honest comparison: least cost against how far from the goal a plan may end, for the exact contact problem.

    points = front(load_scene("three_cart"), (0.0, 1e-3, 1e-2, 5e-2, 0.2))
    [(point.tolerance, point.solution.cost) for point in points]

A cold start at each tolerance first: which windows are best changes on the way (three carts: two windows at 0.01, one at 0.001). Then the
plans are handed on, outwards and inwards: each tolerance is solved again from its neighbour's windows, and the cheaper plan is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from types import MappingProxyType

from formulations.catalog import load_method
from formulations.method import OptionError
from formulations.solution import Solution
from models.scene import Scene
from models.trajectory import Trajectory

# A neighbour's windows are searched around if they cost less than this part of the best known, before anything was shifted: between two
# tolerances the best windows move by some ten steps, which cost up to a tenth.
_WORTH_A_SEARCH = 1.2


@dataclass(frozen=True, kw_only=True)
class FrontPoint:
    """tolerance: largest norm of (q, v)[T] - goal; solution: the cheapest plan found within it (no trajectory: none was found)."""

    tolerance: float
    solution: Solution


def front(
    scene: Scene, tolerances: Iterable[float], *, options: Mapping[str, object] = MappingProxyType({}), time_limit: float = 600.0
) -> tuple[FrontPoint, ...]:
    """Points by increasing tolerance. options: of method mpcc; time_limit: wall seconds for all of them."""
    ordered = sorted(set(tolerances))
    if not ordered:
        raise OptionError("front: no tolerance was given; name at least one, e.g. 0.0.")
    end = perf_counter() + time_limit

    def solve(tolerance: float, plan: Trajectory | None, search: object) -> Solution:
        own = {**options, "goal_tolerance": tolerance, "search": search}
        with load_method("mpcc").open(scene, own) as session:
            return session.solve(eps=None, warm_start=plan, time_limit=max(1e-3, end - perf_counter()))

    wanted = options.get("search", True)
    best = {tolerance: solve(tolerance, None, wanted) for tolerance in ordered}
    for sweep in (ordered, ordered[::-1]):
        for before, tolerance in pairwise(sweep):
            plan = best[before].trajectory
            if plan is None or perf_counter() >= end:
                continue
            found = solve(tolerance, plan, False)
            if wanted and _cost(found) < _WORTH_A_SEARCH * _cost(best[tolerance]):
                found = solve(tolerance, found.trajectory, True)
            if _cost(found) < _cost(best[tolerance]):
                best[tolerance] = found
    points: list[FrontPoint] = []
    for tolerance in ordered:
        cheaper = points and _cost(points[-1].solution) < _cost(best[tolerance])
        points.append(FrontPoint(tolerance=tolerance, solution=points[-1].solution if cheaper else best[tolerance]))
    return tuple(points)


def _cost(solution: Solution) -> float:
    return float("inf") if solution.cost is None else solution.cost
