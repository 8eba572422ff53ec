"""Exact contact for every scene: the cheapest plan of several pipelines from a cold start.

    mpcc has a plan to follow:    mpcc, relaxed+strict, softplus_dc+strict
    otherwise:                    relaxed+strict, softplus_dc+strict, relaxed_walk+strict,
                                  softly_shot+strict
    none of these has a plan:     strict
    none is followed:             newton_shooting from random pushes, on ever finer steps

`departure` compares the motion on finer steps with the plan, with feedback, in parts of what the
scene allows. A plan above 1 is solved again on shorter steps, and is taken only if there is no
other. docs/campaigns.md has figures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from time import monotonic

from formulations.grids import (
    check_warm_start,
    departure,
    finer_scene,
    motion_on_finer_steps,
    on_grid,
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
from models.errors import MachineError
from models.scene import Scene
from models.stability import step_stability
from models.trajectory import Trajectory

_MODES = find_pipeline("mpcc")
_STRICT = find_pipeline("strict")
_SHOT = Leg(method="newton_shooting")
# Relative difference of equal costs.
_SAME = 1e-9
# Departure that ends the refinement; the rest is for the judge's own error and unmeasured
# quantities. `push_box` departs by 1.64, 0.80 and 0.31 on its grid and on steps a half and a
# quarter as long. `hopper_planar` departs by 1.005 and 0.53.
_CLEARLY = 0.75
# Pipelines skipped if mpcc has a plan that is followed.
_WITHOUT_MODES = (RELAXED_WALK, SOFTLY_SHOT)
# The contact modes of a plan and cheaper adjacent ones, without a wider search.
_MODES_OF_SHOT = Leg(method="strict_lcp", options={"attack_iterations": 1})
# Halvings for a shot per halving for strict_lcp; a shot takes milliseconds a step.
_SHOT_HALVINGS = 2
# Largest number of halvings to a stable step; with more, plans start on the task's steps.
_STABLE_HALVINGS = 3
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

        After a first plan, an error of another pipeline is only a sentence in `crashed`. Random
        pushes are the last resort: the other pipelines find cheaper plans.
        """
        solved: list[Solution] = []
        by_modes = False  # whether mpcc has a plan that is followed
        first_error: Exception | None = None
        for way in self._method.ways:
            if load_method(way.legs[0].method).accepts(self._scene) is not None:
                continue
            if way in _WITHOUT_MODES and by_modes and not self._options.all_ways:
                continue
            if way is _STRICT and solved:
                continue
            try:
                # Without a plan a pipeline may use half of the remaining time.
                now = monotonic()
                last = ends - _FOR_FINER * time_limit if solved else now + (ends - now) / 2.0
                solution = _with_departure(self._scene, self._way(way, start, last))
            except MachineError:  # a full disk, for example, ends all pipelines
                raise
            except Exception as error:  # noqa: BLE001 - earlier plans are kept
                first_error = first_error or error
                crashed.append(_crash(way.name, error))
                continue
            solved += [solution] if solution.outcome is Outcome.SOLVED else []
            by_modes = by_modes or (way is _MODES and bool(solved) and _is_followed(solution))
            yield way.name, solution
            if monotonic() >= (last if solved else ends):
                break
        is_done = False
        if solved and not (is_done := _is_followed(cheapest := _cheapest(solved))):
            for words, solution in self._kept(self._on_finer_steps(cheapest, ends), crashed):
                solves = solution.outcome is Outcome.SOLVED
                is_done = is_done or (solves and _is_followed(solution))
                yield words, solution
        if is_done or any(map(_is_followed, solved)):
            return
        found = 0
        for words, solution in self._kept(self._shots(ends), crashed):
            found += solution.outcome is Outcome.SOLVED
            yield words, solution
        if first_error is not None and not solved and not found:
            raise first_error

    def _shots(self, ends: float) -> Iterator[tuple[str, Solution]]:
        """Yield a shot from random pushes and its contact modes, then shots on finer steps."""
        scene = self._scene
        if load_method(_SHOT.method).accepts(scene) is not None or monotonic() >= ends:
            return
        best = _with_contact_departure(scene, _solved(scene, _SHOT, None, ends)[-1])
        yield _SHOT.method, best
        if best.outcome is Outcome.SOLVED and monotonic() < ends:
            modes = _solved(scene, _MODES_OF_SHOT, best.trajectory, ends)[-1]
            improved = _with_contact_departure(scene, modes)
            yield f"{_SHOT.method}, its modes by strict_lcp", improved
            best = min(best, improved, key=_order)
        for _ in range(_SHOT_HALVINGS * self._options.halvings):
            if monotonic() >= ends or _is_clear(best):
                return
            plan = best.trajectory if best.outcome is Outcome.SOLVED else None
            motion = None if plan is None else motion_on_finer_steps(scene, plan, 2)
            scene = finer_scene(scene, 2)
            best = _with_contact_departure(scene, _solved(scene, _SHOT, motion, ends)[-1])
            yield f"{_SHOT.method}, on {scene.task.steps} steps", best

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

    def _on_finer_steps(self, coarse: Solution, ends: float) -> Iterator[tuple[str, Solution]]:
        """Solve by strict_lcp on repeatedly halved steps, from the motion of the previous plan."""
        scene, solution = self._scene, coarse
        for _ in range(self._options.halvings):
            plan = solution.trajectory
            motion = None if plan is None else motion_on_finer_steps(scene, plan, 2)
            if motion is None or monotonic() >= ends:
                return
            scene = finer_scene(scene, 2)
            solution = _with_departure(scene, _solved(scene, _STRICT.legs[0], motion, ends)[-1])
            yield f"strict from the cheapest of these, on {scene.task.steps} steps", solution
            if solution.outcome is not Outcome.SOLVED or _is_clear(solution):
                return


def _solved(scene: Scene, leg: Leg, start: Trajectory | None, ends: float) -> tuple[Solution, ...]:
    pipeline = Pipeline(name=leg.method, title="", legs=(leg,))
    left = max(1e-3, ends - monotonic())
    return tuple(solve_stages(scene, pipeline, warm_start=start, time_limit=left))


def _with_departure(scene: Scene, solution: Solution) -> Solution:
    """Return a solved plan with the residual `departure`."""
    if solution.outcome is not Outcome.SOLVED or solution.trajectory is None:
        return solution
    departs = departure(scene, solution.trajectory)
    return replace(solution, residuals={**solution.residuals, _DEPARTURE: departs})


def _with_contact_departure(scene: Scene, solution: Solution) -> Solution:
    """Return a solved plan with the residual `departure`, in which contacts count too."""
    solution = _with_departure(scene, solution)
    if _DEPARTURE not in solution.residuals or solution.trajectory is None:
        return solution
    departs = max(solution.residuals[_DEPARTURE], contact_departure(scene, solution.trajectory))
    return replace(solution, residuals={**solution.residuals, _DEPARTURE: departs})


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


def _order(solution: Solution) -> tuple[bool, float]:
    is_solved = solution.outcome is Outcome.SOLVED
    return not is_solved, solution.residuals.get(_DEPARTURE, 0.0)


def _best(solutions: list[Solution]) -> Solution:
    """Return the cheapest solved plan that is followed, else the closest one, else any plan."""
    solved = [
        each for each in solutions if each.outcome is Outcome.SOLVED and each.cost is not None
    ]
    followed = [*filter(_is_followed, solved)]
    if solved and not followed:
        return min(solved, key=lambda each: each.residuals[_DEPARTURE])
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
