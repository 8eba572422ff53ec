"""Exact contact for every scene: the cheapest plan of several pipelines from a cold start.

    always:                            mpcc, newton_shooting from random pushes and on finer steps,
                                       relaxed+strict, softplus_dc+strict
    mpcc has no plan to follow,
    and none of these is clearly so:   relaxed_walk+strict, softly_shot+strict
    none of these has a plan:          strict
    the cheapest is not followed:      it is solved again on ever finer steps, then the closest

`departure` compares the motion on finer steps with the plan, without and with feedback, and the
contacts of both, in parts of what the scene allows. A plan above 1 is taken only if there is no
other. docs/planning.md has figures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from time import monotonic

import numpy as np

from formulations.grids import (
    check_warm_start,
    departure,
    finer_scene,
    motion_on_finer_steps,
    on_grid,
    scene_of,
)
from formulations.impulses import contact_departure
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
from models.codegen.kernel import load_kernel
from models.errors import MachineError
from models.scene import Scene
from models.stability import step_stability
from models.trajectory import Trajectory

_MODES = find_pipeline("mpcc")
_STRICT = find_pipeline("strict")
# Bounded in work, and cheap: a bank scene takes 0.2 to 8 CPU s.
_PUSHES = Pipeline(
    name="newton_shooting", title="Random pushes", legs=(Leg(method="newton_shooting"),)
)
# Relative difference of equal costs.
_SAME = 1e-9
# Departure that ends the refinement; the rest is for the judge's own error and unmeasured
# quantities. `push_box` departs by 1.64, 0.80 and 0.31 on its grid and on steps a half and a
# quarter as long. `hopper_planar` departs by 1.005 and 0.53.
_CLEARLY = 0.75
# Pipelines skipped if mpcc has a plan that is followed, or any pipeline one that clearly is.
_LONG = (RELAXED_WALK, SOFTLY_SHOT)
# Largest number of halvings to a stable step; with more, plans start on the task's steps.
_STABLE_HALVINGS = 3
# Share of a contact's depth that a plan keeps to if one without a bound is too deep. The rest is for
# the motion between the nodes.
_DEPTH_SHARE = 0.9
_WITHIN_DEPTH = Leg(method="strict_lcp", options={"depth_share": _DEPTH_SHARE})
# Share of the time limit reserved for finer steps.
_FOR_FINER = 0.2
_DEPARTURE = "departure"
_DEPARTS = "On steps a fiftieth as long the motion departs from it, with feedback, by {:.3g} times what the scene allows: its grid is too coarse."
_UNSTABLE = "The task's step of {:g} s is unstable in contact, so the plan has {} steps of {:g} s."


@dataclass(frozen=True, kw_only=True)
class BestExactOptions(Options):
    """Options of `best_exact`."""

    all_ways: bool = option(
        False,
        "run relaxed_walk+strict and softly_shot+strict also if they are not needed",
    )
    halvings: int = option(
        6,
        "how often the steps are halved where the cheapest plan departs by more than is allowed; 0: a plan on the task's grid",
        lower=0,
        upper=10,
    )


def _nothing_stored(legs: Sequence[Leg]) -> None:
    """Return None: outside a campaign no stage is stored."""


class BestExactSession(Session):
    """Run the sessions of the other methods one after the other."""

    def __init__(self, method: BestExact, scene: Scene, options: BestExactOptions) -> None:
        self._method, self._task, self._options = method, scene, options
        self._scene = _stable(scene, min(options.halvings, _STABLE_HALVINGS))
        self._stored: StoredStages = _nothing_stored

    def use_stored(self, stored: StoredStages) -> None:
        """Read stages of the pipelines from a campaign's store."""
        if self._scene is self._task:
            self._stored = stored

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Return the cheapest plan of all pipelines, each started from `warm_start`.

        Seconds and iterations are sums over all pipelines, including stored stages. Raises
        TrajectoryError for a plan of another grid.
        """
        self._method.check_stage(eps, time_limit)
        check_warm_start(self._task, warm_start)
        if warm_start is not None and self._scene is not self._task:
            warm_start = on_grid(warm_start, self._scene)
        ends = monotonic() + time_limit
        crashed: list[str] = []
        named = list(self._solutions(warm_start, ends, time_limit, crashed))
        best = _best([solution for _, solution in named])
        attempts = tuple(
            Attempt(start=words, outcome=each.outcome, cost=each.cost) for words, each in named
        )
        words = next(words for words, each in named if each is best)
        message = (
            f"The best of {len(named)} ways, by {words}: {best.message}"
            if len(named) > 1
            else best.message
        )
        if self._scene is not self._task:
            task = self._scene.task
            message = (
                f"{ended(message)} {_UNSTABLE.format(self._task.task.step, task.steps, task.step)}"
            )
        if crashed:
            message = f"{ended(message)} {' '.join(crashed)}"
        return replace(
            best,
            method=self._method.name,
            message=message
            if _is_followed(best)
            else f"{ended(message)} {_DEPARTS.format(best.residuals[_DEPARTURE])}",
            iterations=sum(each.iterations for _, each in named),
            seconds=sum((each.seconds for _, each in named), Seconds()),
            options=asdict(self._options),
            starts=attempts if len(named) > 1 else best.starts,
        )

    def _solutions(
        self, start: Trajectory | None, ends: float, time_limit: float, crashed: list[str]
    ) -> Iterator[tuple[str, Solution]]:
        """Yield the name and the solution of each pipeline, then of each solve on finer steps.

        After a first plan, an error of another pipeline is only a sentence in `crashed`.
        """
        solved: list[Solution] = []
        coarse: list[Solution] = []  # those on the task's steps
        is_enough = False  # whether the long pipelines are not needed
        first_error: Exception | None = None
        for way in self._method.ways:
            if load_method(way.legs[0].method).accepts(self._scene) is not None:
                continue
            if way in _LONG and is_enough and not self._options.all_ways:
                continue
            if way is _STRICT and solved:
                continue
            try:
                # Without a plan that is followed a pipeline may use half of the remaining time.
                is_safe = any(map(_is_followed, solved))
                last = ends - _FOR_FINER * time_limit if is_safe else _half(ends)
                solution = _with_departure(self._scene, self._way(way, start, last))
            except MachineError:  # a full disk, for example, ends all pipelines
                raise
            except Exception as error:  # noqa: BLE001 - earlier plans are kept
                first_error = first_error or error
                crashed.append(_crash(way.name, error))
                continue
            if solution.outcome is Outcome.SOLVED:
                solved.append(solution)
                coarse.append(solution)
                by_modes = way is _MODES and _is_followed(solution)
                is_enough = is_enough or by_modes or _is_clear(solution)
            yield way.name, solution
            is_shot = way is _PUSHES and solution.outcome is Outcome.SOLVED
            if is_shot and not _is_followed(solution):
                shots = self._on_finer_steps(solution, _half(ends), by_strict=False)
                for words, finer in self._kept(shots, crashed):
                    solved += [finer] if finer.outcome is Outcome.SOLVED else []
                    is_enough = is_enough or _is_clear(finer)
                    yield words, finer
            if monotonic() >= (last if is_safe else ends):
                break
        for words, solution in self._kept(self._refined(solved, coarse, ends), crashed):
            solved += [solution] if solution.outcome is Outcome.SOLVED else []
            yield words, solution
        if first_error is not None and not solved:
            raise first_error

    def _refined(
        self, solved: Sequence[Solution], coarse: Sequence[Solution], ends: float
    ) -> Iterator[tuple[str, Solution]]:
        """Yield solutions on finer steps until a plan is followed.

        First come those of the cheapest plan on the task's steps, then those of the closest one.
        Without a plan random pushes are tried on finer steps.
        """
        if not solved:
            yield from self._on_finer_steps(None, ends)
            return
        if _is_followed(_cheapest(list(solved))):
            return
        cheapest = _cheapest(list(coarse))
        others = [each for each in coarse if each is not cheapest]
        last = _half(ends) if others else ends
        is_done = any(map(_is_followed, solved))
        for words, solution in self._on_finer_steps(cheapest, last):
            is_done = is_done or (solution.outcome is Outcome.SOLVED and _is_followed(solution))
            yield words, solution
        if others and not is_done:
            yield from self._on_finer_steps(min(others, key=_departure_of), ends)

    def _kept(
        self, solutions: Iterator[tuple[str, Solution]], crashed: list[str]
    ) -> Iterator[tuple[str, Solution]]:
        try:
            yield from solutions
        except MachineError:
            raise
        except Exception as error:  # noqa: BLE001 - earlier plans are kept
            crashed.append(_crash("finer steps", error))

    def _way(self, way: Pipeline, start: Trajectory | None, ends: float) -> Solution:
        """Return the last stage of a pipeline, with the iterations and seconds of all its stages.

        A leg without a plan ends the pipeline: cold strict_lcp is a pipeline of its own. Stored
            stages
        are from a cold start.
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

    def _on_finer_steps(
        self, coarse: Solution | None, ends: float, by_strict: bool = True
    ) -> Iterator[tuple[str, Solution]]:
        """Solve on repeatedly halved steps, from the motion of the previous plan.

        Each halving is solved by strict_lcp, which lowers the cost, until it has no plan, and by
        newton_shooting after that, or by newton_shooting alone. A plan that is too deep is first solved again within the depths.
        """
        plan = None if coarse is None else coarse.trajectory
        scene = self._scene if plan is None else scene_of(self._scene, plan)
        by_strict = by_strict and plan is not None
        strict = _STRICT.legs[0]
        if plan is not None and by_strict and _is_deep(scene, plan):
            strict = _WITHIN_DEPTH
            solution = _with_departure(scene, _solved(scene, strict, plan, ends)[-1])
            yield f"{strict.method} within the depths", solution
            plan = solution.trajectory if solution.outcome is Outcome.SOLVED else plan
            if _is_clear(solution):
                return
        for _ in range(self._options.halvings):
            motion = None if plan is None else motion_on_finer_steps(scene, plan, 2)
            if monotonic() >= ends or (plan is not None and motion is None):
                return
            scene = finer_scene(scene, 2)
            solution: Solution | None = None
            if by_strict:
                solution = _with_departure(scene, _solved(scene, strict, motion, ends)[-1])
                yield f"{strict.method} on {scene.task.steps} steps", solution
                by_strict = solution.outcome is Outcome.SOLVED
            if not by_strict and load_method(_PUSHES.name).accepts(scene) is None:
                leg = _PUSHES.legs[0]
                solution = _with_departure(scene, _solved(scene, leg, motion, ends)[-1])
                yield f"{leg.method} on {scene.task.steps} steps", solution
            if solution is not None and solution.outcome is Outcome.SOLVED:
                plan = solution.trajectory
                if _is_clear(solution):
                    return
            elif plan is not None:
                return


def _solved(scene: Scene, leg: Leg, start: Trajectory | None, ends: float) -> tuple[Solution, ...]:
    pipeline = Pipeline(name=leg.method, title="", legs=(leg,))
    left = max(1e-3, ends - monotonic())
    return tuple(solve_stages(scene, pipeline, warm_start=start, time_limit=left))


def _with_departure(scene: Scene, solution: Solution) -> Solution:
    """Return a solved plan with the residual `departure`."""
    plan = solution.trajectory
    if solution.outcome is not Outcome.SOLVED or plan is None:
        return solution
    departs = max(departure(scene, plan), contact_departure(scene, plan))
    return replace(solution, residuals={**solution.residuals, _DEPARTURE: departs})


def _half(ends: float) -> float:
    """Return the end of half of the remaining time."""
    now = monotonic()
    return now + (ends - now) / 2.0


def _is_deep(scene: Scene, plan: Trajectory) -> bool:
    """Return whether a contact of the plan uses more of its depth than plans within depths do."""
    deepest = load_kernel(scene).penetration(plan.q).max(axis=0)
    return bool((deepest > _DEPTH_SHARE * np.array(scene.depths)).any())


def _stable(scene: Scene, halvings: int) -> Scene:
    """Return the task on halved steps that are stable in contact, or the task."""
    for halving in range(halvings + 1):
        finer = finer_scene(scene, 2**halving) if halving else scene
        if step_stability(finer).is_stable:
            return finer
    return scene


def _crash(way: str, error: Exception) -> str:
    return f"{way} ended with an error ({type(error).__name__}: {str(error).rstrip('.')})."


def _is_followed(solution: Solution) -> bool:
    return solution.residuals.get(_DEPARTURE, 0.0) <= 1.0


def _is_clear(solution: Solution) -> bool:
    return solution.outcome is Outcome.SOLVED and solution.residuals[_DEPARTURE] <= _CLEARLY


def _departure_of(solution: Solution) -> float:
    return solution.residuals[_DEPARTURE]


def _best(solutions: list[Solution]) -> Solution:
    """Return the cheapest solved plan that is followed, else the closest one, else any plan."""
    solved = [
        each for each in solutions if each.outcome is Outcome.SOLVED and each.cost is not None
    ]
    followed = [*filter(_is_followed, solved)]
    if solved and not followed:
        return min(solved, key=_departure_of)
    priced = followed or [each for each in solutions if each.cost is not None]
    return _cheapest(priced) if priced else solutions[-1]


def _cheapest(priced: list[Solution]) -> Solution:
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
        _PUSHES,
        find_pipeline("relaxed+strict"),
        find_pipeline("softplus_dc+strict"),
        RELAXED_WALK,
        SOFTLY_SHOT,
        _STRICT,
    )

    def session(self, scene: Scene, options: BestExactOptions, clock: Clock) -> Session:
        """Open a session; those of the pipelines are opened later."""
        return BestExactSession(self, scene, options)


METHOD = BestExact()
