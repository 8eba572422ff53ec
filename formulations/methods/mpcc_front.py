"""The honest comparison: least cost against how far from the goal a plan may end, for the exact contact problem.

    points = front(load_scene("three_cart"), (0.0, 1e-3, 1e-2, 5e-2, 0.2))
    [(point.tolerance, point.solution.cost) for point in points]

A sweep: from a cold start at one tolerance the modes are handed on to the next, outwards and
inwards, and searched there, as long as that is cheaper than what is known. The best modes change
the number of their intervals on the way (three carts: two pushes on the left at 0.01, one at 0.001,
one on each side at 0), and no small move leads from one kind to the other: hence three cold starts,
in the middle and at both ends. Where two sweeps meet, the cheaper one goes on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

from formulations.contact_modes.method import why_not
from formulations.method import Clock, Kind, Method, OptionError, Options, Session, option
from formulations.pipelines import load_method
from formulations.solution import FrontPoint, Outcome, Seconds, Solution
from models.scene import Scene
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.contact_modes.session import MpccSession


@dataclass(frozen=True, kw_only=True)
class MpccFrontOptions(Options):
    """Options of `mpcc_front`."""

    tolerances: tuple[float, ...] = option(
        (0.0, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2),
        "largest norms of (q, v)[T] - goal; the plan handed on is that of the smallest",
    )
    work: float = option(
        6.0,
        "most work of a solve, as of mpcc; nearly all go on from the plan of the one before, the three that do not may do mpcc's first_work more",
        unit="millions",
        lower=0.0,
    )
    search: bool = option(True, "search for cheaper contact modes at each tolerance")
    seed: int = option(
        0, "of random starts, tried where the first guess leads nowhere", lower=0, upper=10**9
    )


def checked_tolerances(given: Iterable[float]) -> tuple[float, ...]:
    """Give each tolerance once, in rising order.

    Raises OptionError for what is none, or where there is none.
    """
    values = (
        tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)
    )
    for value in values:
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not 0.0 <= value < float("inf")
        ):
            raise OptionError(
                f"front: {value!r} is no terminal tolerance; give finite numbers of at least 0."
            )
    if not values:
        raise OptionError("front: no tolerance was given; name at least one, e.g. 0.0.")
    return tuple(sorted({float(value) for value in values}))


def front(
    scene: Scene,
    tolerances: Iterable[float],
    *,
    options: Mapping[str, object] = MappingProxyType({}),
    start: Trajectory | None = None,
    time_limit: float = 600.0,
) -> tuple[FrontPoint, ...]:
    """Solve for the least cost within each tolerance; points by increasing tolerance.

    options: of method mpcc; start: a plan that the first solve starts from; time_limit: wall
        seconds for all of them. Raises OptionError for a tolerance
    or an option that is none, and for a scene that mpcc does not accept.
    """
    ordered = checked_tolerances(tolerances)
    end = perf_counter() + time_limit
    best: dict[float, Solution] = {}
    opened = cast(
        "MpccSession", load_method("mpcc").open(scene, {**options, "goal_tolerance": ordered[0]})
    )

    def solve(tolerance: float, plan: Trajectory | None) -> tuple[Solution, bool]:
        """What was found there, and whether it is cheaper than all before."""
        with opened.within(tolerance, from_a_plan=plan is not None) as session:
            found = session.solve(
                eps=None, warm_start=plan, time_limit=max(1e-3, end - perf_counter())
            )
        is_better = tolerance not in best or _cost(found) < _cost(best[tolerance])
        if is_better:
            best[tolerance] = found
        return found, is_better

    def sweep(plan: Trajectory | None, way: Iterable[float]) -> None:
        for tolerance in way:
            if plan is None or perf_counter() >= end:
                return
            found, is_better = solve(tolerance, plan)
            if not is_better:
                return
            plan = found.trajectory

    for place in dict.fromkeys((len(ordered) // 2, 0, len(ordered) - 1)):
        if best and perf_counter() >= end:
            break
        found, _ = solve(ordered[place], start)
        sweep(found.trajectory, ordered[place + 1 :])
        sweep(found.trajectory, ordered[:place][::-1])
    skipped: dict[float, Solution] = {}
    for tolerance in reversed(ordered):  # a sweep may have ended before it got here
        if tolerance in best or perf_counter() >= end:
            continue
        without = next(
            (
                larger
                for larger in ordered
                if larger > tolerance and larger in best and best[larger].trajectory is None
            ),
            None,
        )
        if without is None:
            solve(tolerance, start)
        else:
            # Plans within a tolerance are among those within a larger one: where none of these was
            # found, none is looked for.
            message = (
                f"Not tried: within the larger tolerance {without:g} no plan was found either."
            )
            skipped[tolerance] = Solution(method="mpcc", outcome=Outcome.STALLED, message=message)
    return _falling(ordered, {**skipped, **best})


def _falling(ordered: tuple[float, ...], best: Mapping[float, Solution]) -> tuple[FrontPoint, ...]:
    """A plan within a tolerance is within every larger one: costs never rise."""
    points: list[FrontPoint] = []
    for tolerance in ordered:
        own = best.get(tolerance) or Solution(
            method="mpcc",
            outcome=Outcome.TIME_LIMIT,
            message="the time was over before this tolerance.",
        )
        cheaper = points and _cost(points[-1].solution) < _cost(own)
        points.append(
            FrontPoint(tolerance=tolerance, solution=points[-1].solution if cheaper else own)
        )
    return tuple(points)


def _cost(solution: Solution) -> float:
    return float("inf") if solution.cost is None else solution.cost


class MpccFrontSession(Session):
    """The sweep of `front` as one stage, whose plan is that of the smallest tolerance."""

    def __init__(
        self, method: MpccFront, scene: Scene, options: MpccFrontOptions, clock: Clock
    ) -> None:
        self._method, self._scene = method, scene
        self._options = replace(options, tolerances=checked_tolerances(options.tolerances))
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Sweep over the tolerances."""
        self._method.check_stage(eps, time_limit)
        stage = Clock()
        own = {
            "work": self._options.work,
            "search": self._options.search,
            "seed": self._options.seed,
        }
        points = front(
            self._scene,
            self._options.tolerances,
            options=own,
            start=warm_start,
            time_limit=time_limit,
        )
        first = points[0].solution
        solutions = list({id(point.solution): point.solution for point in points}.values())
        found = sum(point.solution.trajectory is not None for point in points)
        late = any(point.solution.outcome is Outcome.TIME_LIMIT for point in points)
        outcome = Outcome.TIME_LIMIT if late and first.outcome is Outcome.SOLVED else first.outcome
        return replace(
            first,
            method=self._method.name,
            outcome=outcome,
            message=front_message(found, points, first.message),
            options=asdict(self._options),
            iterations=sum(solution.iterations for solution in solutions),
            seconds=_sum(solutions, stage, self._clock),
            solver=next((solution.solver for solution in solutions if solution.solver), ""),
            front=points,
        )


def front_message(found: int, points: tuple[FrontPoint, ...], message: str) -> str:
    """Say how many points have a plan, and how the first of them ended, whose tolerance is the smallest."""
    if not found:
        return f"No plan was found within any of {len(points)} terminal tolerances: {message}"
    began = f"Plans were found within {found} of {len(points)} terminal tolerances"
    if points[0].solution.trajectory is None:
        return f"{began}, none within {points[0].tolerance:g}: {message}"
    return f"{began}; this is the one within {points[0].tolerance:g}. {message[:1].upper()}{message[1:]}"


def _sum(solutions: list[Solution], stage: Clock, opening: Clock) -> Seconds:
    """Seconds of the solves that the front is made of.

    Wall and cpu are those of the whole sweep and of opening it.
    """
    stage.stop()
    wall, cpu = (sum(pair) for pair in zip(stage.pay(), opening.pay(), strict=True))
    return replace(sum((solution.seconds for solution in solutions), Seconds()), wall=wall, cpu=cpu)


class MpccFront(Method[MpccFrontOptions]):
    """`mpcc` within each of several tolerances around the goal."""

    name = "mpcc_front"
    title = "Exact contact, least cost within each terminal tolerance"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = MpccFrontOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without a goal, and those that mpcc refuses."""
        if not scene.task.has_goal:
            return f"scene {scene.name} leaves its end free, so there is no terminal error to trade for cost."
        return why_not(scene)

    def session(self, scene: Scene, options: MpccFrontOptions, clock: Clock) -> Session:
        """Open a session, which opens mpcc when it is solved."""
        return MpccFrontSession(self, scene, options, clock)


METHOD = MpccFront()
