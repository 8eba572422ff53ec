"""Exact contact for every scene: run several pipelines from a cold start and keep the cheapest plan.

    mpcc has a plan to follow:    mpcc, relaxed+strict, softplus_dc+strict
    otherwise:                    relaxed_walk+strict, relaxed+strict, softplus_dc+strict,
                                  softly_shot+strict
    none of these has a plan:     strict

No pipeline is the best on every scene. Exact costs by the four pipelines of the second line:
transport 0.704, 0.916, 0.701, 1.84; two_finger_lift 59.410, 59.399, 77.2, 59.410; a drawer on a
rough rail 25.9, 26.5, none, 9.5. A row of carts by the three of the first line: 981, 855, none.
A campaign has stored most of these stages already (`Session.use_stored`).

An exact plan solves the equations of its grid, and a robot does not move on a grid. So each is
followed on finer steps by linear feedback around it (`formulations.grids`): how far the motion
leaves the plan and misses the goal, and what the feedback takes of the plan's own inputs, in parts
of what the scene allows. Where that is more than 1 for the cheapest plan, it is solved again on
steps a half, a quarter and an eighth as long, from the motion that followed it, until it is clearly
less. A plan with more than 1 is taken only where there is no other, and of these the one that
departs least.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from time import monotonic

from formulations.grids import departure, finer_scene, motion_on_finer_steps
from formulations.method import (
    Clock,
    Kind,
    Leg,
    Method,
    Options,
    Pipeline,
    Session,
    StoredStages,
    option,
)
from formulations.pipelines import (
    RELAXED_WALK,
    SOFTLY_SHOT,
    find_pipeline,
    load_method,
    solve_stages,
)
from formulations.solution import Attempt, Outcome, Seconds, Solution, as_asked, ended
from models.errors import MachineError
from models.scene import Scene
from models.trajectory import Trajectory

_MODES = find_pipeline("mpcc")
_STRICT = find_pipeline("strict")
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

    all_ways: bool = option(
        False,
        "where mpcc has a plan, run relaxed_walk+strict and softly_shot+strict too",
    )
    halvings: int = option(
        3,
        "how often the steps are halved where the cheapest plan departs by more than is allowed; 0: a plan on the task's grid",
        lower=0,
        upper=10,
    )


def _nothing_stored(legs: Sequence[Leg]) -> None:
    """Return None: outside a campaign no stage is stored."""


class BestExactSession(Session):
    """Opens the sessions of the other methods, one after the other."""

    def __init__(self, method: BestExact, scene: Scene, options: BestExactOptions) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._stored: StoredStages = _nothing_stored

    def use_stored(self, stored: StoredStages) -> None:
        """Read stages of the pipelines from a campaign's store."""
        self._stored = stored

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Return the cheapest plan of all pipelines, each started from `warm_start`.

        Seconds and iterations are the sums over all pipelines, stored stages included. Raises
        TrajectoryError for a plan of another grid.
        """
        self._method.check_stage(eps, time_limit)
        ends = monotonic() + time_limit
        crashed: list[str] = []
        found = list(self._found(warm_start, ends, crashed))
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
        if crashed:
            message = f"{ended(message)} {' '.join(crashed)}"
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

    def _found(
        self, start: Trajectory | None, ends: float, crashed: list[str]
    ) -> Iterator[tuple[str, Solution]]:
        """Yield the name and the solution of each pipeline, then of each solve on finer steps.

        Once a plan is found, an error in another way costs that way alone: a sentence in `crashed`.
        """
        scene = self._scene
        solved: list[Solution] = []
        by_modes = False  # whether mpcc has a plan that is followed
        first_error: Exception | None = None
        for way in self._method.ways:
            if way is _MODES and load_method("mpcc").accepts(scene) is not None:
                continue
            if way in (RELAXED_WALK, SOFTLY_SHOT) and by_modes and not self._options.all_ways:
                continue
            if way is _STRICT and solved:
                continue
            try:
                found = _with_departure(scene, self._way(way, start, ends))
            except MachineError:  # a full disk, for example, ends the other ways too
                raise
            except Exception as error:  # noqa: BLE001 - plans that are found are kept
                first_error = first_error or error
                crashed.append(_crash(way.name, error))
                continue
            solved += [found] if found.outcome is Outcome.SOLVED else []
            by_modes = by_modes or (way is _MODES and bool(solved) and _is_followed(found))
            yield way.name, found
            if monotonic() >= ends:
                break
        if first_error is not None and not solved:
            raise first_error
        if solved and not _is_followed(cheapest := _cheapest(solved)):
            try:
                yield from self._on_finer_steps(cheapest, ends)
            except MachineError:
                raise
            except Exception as error:  # noqa: BLE001 - plans that are found are kept
                crashed.append(_crash("strict on finer steps", error))

    def _way(self, way: Pipeline, start: Trajectory | None, ends: float) -> Solution:
        """Return the last stage of a pipeline, with the iterations and seconds of all its stages.

        A leg without a plan ends the pipeline: strict_lcp from a cold start is a pipeline of its
        own. Stored stages are from a cold start too.
        """
        plan, iterations, seconds = start, 0, Seconds()
        for number, leg in enumerate(way.legs):
            stored = self._stored(way.legs[: number + 1]) if start is None else None
            stages = stored or _solved(self._scene, leg, plan, ends)
            iterations += sum(stage.iterations for stage in stages)
            seconds = sum((stage.seconds for stage in stages), seconds)
            plans = [stage.trajectory for stage in stages if stage.trajectory is not None]
            if not plans:
                break
            plan = plans[-1]
        last = stages[-1]
        if number + 1 < len(way.legs):
            last = replace(last, trajectory=None, cost=None)
        return replace(as_asked(self._scene, last), iterations=iterations, seconds=seconds)

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
            found = _with_departure(scene, _solved(scene, _STRICT.legs[0], motion, ends)[-1])
            yield f"strict from the cheapest of these, on {scene.task.steps} steps", found
            if found.outcome is not Outcome.SOLVED or found.residuals[_DEPARTURE] <= _CLEARLY:
                return


def _solved(scene: Scene, leg: Leg, start: Trajectory | None, ends: float) -> tuple[Solution, ...]:
    """Solve the stages of a leg. ends: time.monotonic() of the time limit."""
    alone = Pipeline(name=leg.method, title="", legs=(leg,))
    left = max(1e-3, ends - monotonic())
    return tuple(solve_stages(scene, alone, warm_start=start, time_limit=left))


def _with_departure(scene: Scene, found: Solution) -> Solution:
    """The same with the residual `departure` where it is solved."""
    if found.outcome is not Outcome.SOLVED or found.trajectory is None:
        return found
    return replace(
        found, residuals={**found.residuals, _DEPARTURE: departure(scene, found.trajectory)}
    )


def _crash(way: str, error: Exception) -> str:
    """Return a sentence on an error within a pipeline."""
    return f"{way} ended with an error ({type(error).__name__}: {str(error).rstrip('.')})."


def _is_followed(found: Solution) -> bool:
    return found.residuals.get(_DEPARTURE, 0.0) <= 1.0


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
    """Exact contact by several pipelines."""

    name = "best_exact"
    title = "Exact contact, the cheapest plan of several pipelines"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = BestExactOptions
    ways = (
        _MODES,
        RELAXED_WALK,
        find_pipeline("relaxed+strict"),
        find_pipeline("softplus_dc+strict"),
        SOFTLY_SHOT,
        _STRICT,
    )

    def session(self, scene: Scene, options: BestExactOptions, clock: Clock) -> Session:
        """Open a session; the sessions of the pipelines are opened one after the other."""
        return BestExactSession(self, scene, options)


METHOD = BestExact()
