"""`mpcc_front` opened on a scene: the sweep of `front` as one stage, whose plan is that of the smallest tolerance."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from time import perf_counter, process_time
from typing import TYPE_CHECKING

from formulations.method import Method, OptionError, Session
from formulations.solution import FrontPoint, Outcome, Seconds, Solution
from formulations.windows.front import checked_tolerances, front
from models.scene import Scene
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.mpcc_front import MpccFrontOptions


class FrontSession(Session):
    """See the module docstring."""

    def __init__(self, method: Method, scene: Scene, options: MpccFrontOptions, opening: tuple[float, float]) -> None:
        self._method, self._scene = method, scene
        self._options = replace(options, tolerances=checked_tolerances(options.tolerances))
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        wall, cpu = perf_counter() - self._opening[0], process_time() - self._opening[1]
        self._opening = (0.0, 0.0)
        own = {"work": self._options.work, "search": self._options.search, "seed": self._options.seed}
        points = front(self._scene, self._options.tolerances, options=own, start=warm_start, time_limit=time_limit)
        first = points[0].solution
        solutions = list({id(point.solution): point.solution for point in points}.values())
        found = sum(point.solution.trajectory is not None for point in points)
        late = any(point.solution.outcome is Outcome.TIME_LIMIT for point in points)
        outcome = Outcome.TIME_LIMIT if late and first.outcome is Outcome.SOLVED else first.outcome
        return replace(
            first,
            method=self._method.name,
            outcome=outcome,
            message=told(found, points, first.message),
            options=asdict(self._options),
            iterations=sum(solution.iterations for solution in solutions),
            seconds=_together(solutions, perf_counter() - wall, process_time() - cpu),
            front=points,
        )


def told(found: int, points: tuple[FrontPoint, ...], message: str) -> str:
    """How many points have a plan, and how the first of them ended, whose tolerance is the smallest."""
    if not found:
        return f"No plan was found within any of {len(points)} terminal tolerances: {message}"
    began = f"Plans were found within {found} of {len(points)} terminal tolerances"
    if points[0].solution.trajectory is None:
        return f"{began}, none within {points[0].tolerance:g}: {message}"
    return f"{began}; this is the one within {points[0].tolerance:g}. {message[:1].upper()}{message[1:]}"


def _together(solutions: list[Solution], wall: float, cpu: float) -> Seconds:
    """Seconds of the solves that the front is made of; wall and cpu are those of the whole sweep."""
    parts = {item.name: sum(getattr(solution.seconds, item.name) for solution in solutions) for item in fields(Seconds)}
    return Seconds(**{**parts, "wall": wall, "cpu": cpu})
