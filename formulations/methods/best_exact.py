"""Exact contact on every scene, from a cold start: several ways are gone, and the cheapest plan is kept.

    contacts that are open or closed:  mpcc, which searches their modes; it has a plan -> done
    else four ways:                    relaxed_lcp walked down from eps = 0.9, and from 1e-2 ->
                                       strict_lcp
                                       softplus_dc walked down from eps = 1e-3   -> strict_lcp
                                       softplus_multiple_shooting, eps = 1e-3 .. 1e-48
                                           -> strict_lcp

A walk chooses its own eps (`transcription.homotopy`). No way is the best one: exact cost by the
first to the fourth, transport 0.704, 0.916, 0.701 and 1.84, two_finger_lift 59.410, 59.399, 77.2
and 59.410, hopper_planar none, none, 737.8 and 748.8, a drawer pushed shut over a rough rail 25.9,
26.5, none and 9.5. Where the loosest relaxation has no plan a tighter one is not tried, and a walk
that did not come to its end is not followed by strict_lcp while another way has a plan: that is
where 77.2 comes from, and from a cold start 18214 for hopper_planar, in 1600 iterations. Multiple
shooting may stop at its limit: its plan is nearly that of its inputs, and strict_lcp ends near it.

An exact plan solves the equations of its grid, and a robot does not move on a grid. So each is
followed on finer steps by linear feedback around it (`formulations.grids`): how far the motion
leaves the plan and misses the goal, and what the feedback takes of the plan's own inputs, in parts
of what the scene allows. Where that is more than 1 for the cheapest plan, it is solved again on
steps a half, a quarter and an eighth as long, from the motion that followed it, until it is clearly
less. A plan with more than 1 is taken only where there is no other, and of these the one that
departs least.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from time import monotonic

from formulations.grids import departure, finer_scene, motion_on_finer_steps
from formulations.method import Clock, Kind, Method, Options, Session, option
from formulations.pipelines import (
    MULTIPLE_SHOOTING_COUNT,
    MULTIPLE_SHOOTING_EPS,
    RELAXED_EPS,
    RELAXED_FROM,
    SOFTPLUS_EPS,
    load_method,
)
from formulations.solution import Attempt, Outcome, Seconds, Solution, ended
from models.scene import Scene
from models.trajectory import Trajectory

# (method, its options, eps that are asked for)
_WAYS: tuple[tuple[str, Mapping[str, float], tuple[float, ...]], ...] = (
    ("relaxed_lcp", {"first_eps": RELAXED_FROM}, RELAXED_EPS[-1:]),
    ("relaxed_lcp", {"first_eps": RELAXED_EPS[0]}, RELAXED_EPS[-1:]),
    ("softplus_dc", {"first_eps": SOFTPLUS_EPS[0]}, SOFTPLUS_EPS[-1:]),
    (
        "softplus_multiple_shooting",
        {"max_iterations": MULTIPLE_SHOOTING_COUNT},
        MULTIPLE_SHOOTING_EPS,
    ),
)
# Part of a cost by which two are the same.
_SAME = 1e-9
# A plan is solved again on finer steps until it departs by at most this part of what is allowed:
# what is not measured here, contact forces and the judge's own error, has the rest. push_box
# departs by 1.64, 0.80 and 0.31 on its grid and on steps a half and a quarter as long,
# hopper_planar by 1.005 and 0.53.
_CLEARLY = 0.75
_DEPARTURE = "departure"
_DEPARTS = "On steps a fiftieth as long the motion departs from it, with feedback, by {:.3g} times what the scene allows: its grid is too coarse."


@dataclass(frozen=True, kw_only=True)
class BestExactOptions(Options):
    """Options of `best_exact`."""

    all_ways: bool = option(False, "go the other ways too where mpcc has a plan")
    halvings: int = option(
        3,
        "how often the steps are halved where the cheapest plan departs by more than is allowed; 0: a plan on the task's grid",
        lower=0,
        upper=10,
    )


class BestExactSession(Session):
    """Opens the sessions of the other methods, one after the other."""

    def __init__(self, method: BestExact, scene: Scene, options: BestExactOptions) -> None:
        self._method, self._scene, self._options = method, scene, options

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Find the cheapest plan of all ways; the walks start from the plan given too.

        Raises TrajectoryError for a plan of another grid.
        """
        self._method.check_stage(eps, time_limit)
        ends = monotonic() + time_limit
        found = list(self._found(warm_start, ends))
        best = _best([solution for _, solution in found])
        attempts = tuple(
            Attempt(start=words, outcome=each.outcome, cost=each.cost) for words, each in found
        )
        words = next(words for words, each in found if each is best)
        message = (
            f"The best of {len(found)} ways, by {words}: {best.message}"
            if len(found) > 1
            else best.message
        )
        return replace(
            best,
            method=self._method.name,
            message=message
            if _is_followed(best)
            else f"{ended(message)} {_DEPARTS.format(best.residuals[_DEPARTURE])}",
            iterations=sum(each.iterations for _, each in found),
            seconds=sum((each.seconds for _, each in found), Seconds()),
            options=asdict(self._options),
            starts=attempts if len(found) > 1 else best.starts,
        )

    def _found(self, start: Trajectory | None, ends: float) -> Iterator[tuple[str, Solution]]:
        """What each way found, in words and as a solution of all its stages."""
        scene = self._scene
        solved: list[Solution] = []
        if load_method("mpcc").accepts(scene) is None:
            found = self._stage("mpcc", start, ends)
            yield "mpcc", found
            solved += [found] if found.outcome is Outcome.SOLVED else []
            if solved and not self._options.all_ways:
                return
        without: set[str] = set()  # methods with a walk that did not come to its end
        for method, options, schedule in _WAYS:
            if method in without or monotonic() >= ends:
                continue
            words = (
                f"{method} from eps = {options.get('first_eps', schedule[0]):g}, then strict_lcp"
            )
            walked = self._walked(method, schedule, start, ends, options)
            if walked.trajectory is None or (
                "first_eps" in options and solved and walked.outcome is not Outcome.SOLVED
            ):
                without.add(method)
                yield words, replace(walked, trajectory=None, cost=None)
                continue
            exact = _with_departure(
                scene, _after(walked, self._stage("strict_lcp", walked.trajectory, ends))
            )
            solved += [exact] if exact.outcome is Outcome.SOLVED else []
            yield words, exact
        if not solved and monotonic() < ends:
            yield "strict_lcp", self._stage("strict_lcp", start, ends)
        elif solved and not _is_followed(cheapest := _cheapest(solved)):
            yield from self._on_finer_steps(cheapest, ends)

    def _on_finer_steps(self, coarse: Solution, ends: float) -> Iterator[tuple[str, Solution]]:
        """What strict_lcp finds on steps halved again and again, from the motion that followed the plan before."""
        scene, found = self._scene, coarse
        for _ in range(self._options.halvings):
            motion = (
                None
                if found.trajectory is None
                else motion_on_finer_steps(scene, found.trajectory, 2)
            )
            if motion is None or monotonic() >= ends:
                return
            scene = finer_scene(scene, 2)
            found = _with_departure(scene, self._stage("strict_lcp", motion, ends, scene))
            yield f"strict_lcp from the cheapest of these, on {scene.task.steps} steps", found
            if found.outcome is not Outcome.SOLVED or found.residuals[_DEPARTURE] <= _CLEARLY:
                return

    def _walked(
        self,
        method: str,
        schedule: tuple[float, ...],
        start: Trajectory | None,
        ends: float,
        options: Mapping[str, object],
    ) -> Solution:
        """The last stage before one that stalls, with the iterations and seconds of those up to it."""
        with load_method(method).open(self._scene, options) as session:
            walked = session.solve(
                eps=schedule[0], warm_start=start, time_limit=max(1e-3, ends - monotonic())
            )
            for eps in schedule[1:]:
                found = session.solve(
                    eps=eps, warm_start=walked.trajectory, time_limit=max(1e-3, ends - monotonic())
                )
                if found.trajectory is None or found.outcome not in (
                    Outcome.SOLVED,
                    Outcome.ITERATION_LIMIT,
                ):
                    break
                walked = _after(walked, found)
        return walked

    def _stage(
        self, name: str, start: Trajectory | None, ends: float, scene: Scene | None = None
    ) -> Solution:
        with load_method(name).open(scene or self._scene, {}) as session:
            return session.solve(
                eps=None, warm_start=start, time_limit=max(1e-3, ends - monotonic())
            )


def _with_departure(scene: Scene, found: Solution) -> Solution:
    """The same with the residual `departure` where it is solved."""
    if found.outcome is not Outcome.SOLVED or found.trajectory is None:
        return found
    return replace(
        found, residuals={**found.residuals, _DEPARTURE: departure(scene, found.trajectory)}
    )


def _is_followed(found: Solution) -> bool:
    return found.residuals.get(_DEPARTURE, 0.0) <= 1.0


def _after(walked: Solution, exact: Solution) -> Solution:
    """The exact solution with the iterations and seconds of the walk before it."""
    return replace(
        exact,
        iterations=walked.iterations + exact.iterations,
        seconds=walked.seconds + exact.seconds,
    )


def _best(found: list[Solution]) -> Solution:
    """The cheapest that is solved and followed; else that is solved and departs least.

    Else any plan, or the last word.
    """
    solved = [each for each in found if each.outcome is Outcome.SOLVED and each.cost is not None]
    followed = [*filter(_is_followed, solved)]
    if solved and not followed:
        return min(solved, key=lambda each: each.residuals[_DEPARTURE])
    priced = followed or [each for each in found if each.cost is not None]
    return _cheapest(priced) if priced else found[-1]


def _cheapest(priced: list[Solution]) -> Solution:
    """The first of those whose cost differs from the least by rounding."""
    least = min(each.cost for each in priced if each.cost is not None)
    return next(
        each for each in priced if each.cost is not None and each.cost <= least + _SAME * abs(least)
    )


class BestExact(Method[BestExactOptions]):
    """Exact contact by several ways."""

    name = "best_exact"
    title = "Exact contact, the cheapest plan of several ways"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = BestExactOptions

    def session(self, scene: Scene, options: BestExactOptions, clock: Clock) -> Session:
        """Open a session, which opens those of the ways as it goes them."""
        return BestExactSession(self, scene, options)


METHOD = BestExact()
