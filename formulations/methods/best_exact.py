"""Exact contact for every scene: run several pipelines from a cold start and keep the cheapest plan.

    mpcc has a plan to follow:    mpcc, relaxed+strict, softplus_dc+strict
    otherwise:                    shot, shot+strict, relaxed+strict, softplus_dc+strict,
                                  relaxed_walk+strict, softly_shot+strict
    none of these has a plan:     strict

A plan solves the equations of its grid. `departure` measures how far the motion on finer steps
leaves it, with feedback and in its contacts, in parts of what the scene allows. A plan with more
than 1 is solved again on shorter steps, from the motion that followed it, and is taken only if
there is no other. docs/campaigns.md has figures.
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
    plan_of,
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
    SHOT,
    SOFTLY_SHOT,
    find_pipeline,
    load_method,
    solve_stages,
)
from formulations.shots import allowed_miss, corrected, is_motion, off_the_edge
from formulations.solution import Attempt, Outcome, Seconds, Solution, as_asked, ended
from models.codegen.kernel import load_kernel
from models.errors import MachineError
from models.scene import Scene
from models.schemes import Scheme
from models.stability import step_stability
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
# Pipelines that are left out if mpcc has a plan that is followed.
_WITHOUT_MODES = (SHOT, RELAXED_WALK, SOFTLY_SHOT)
# The contact modes of a plan, and those that are cheaper beside them; no search for others.
_MODES_OF_SHOT = Leg(method="strict_lcp", options={"attack_iterations": 1})
# Most halvings to a stable step. Further off, plans are found on the task's steps and refined from
# there.
_STABLE_HALVINGS = 3
# Share of the time limit that the pipelines leave for finer steps.
_FOR_FINER = 0.2
_DEPARTURE = "departure"
# Departure of a plan that is not the motion of its inputs, as in formulations.grids.
_LOST = 1e6
_DEPARTS = "On steps a fiftieth as long the motion departs from it, with feedback, by {:.3g} times what the scene allows: its grid is too coarse."
_UNSTABLE = "The task's step of {:g} s is unstable in contact, so the plan has {} steps of {:g} s."


@dataclass(frozen=True, kw_only=True)
class BestExactOptions(Options):
    """Options of `best_exact`."""

    all_ways: bool = option(
        False,
        "where mpcc has a plan, run the shot, relaxed_walk+strict and softly_shot+strict too",
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
    """Opens the sessions of the other methods, one after the other."""

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

        Seconds and iterations are the sums over all pipelines, stored stages included. Raises
        TrajectoryError for a plan of another grid.
        """
        self._method.check_stage(eps, time_limit)
        check_warm_start(self._task, warm_start)
        if warm_start is not None and self._scene is not self._task:
            warm_start = on_grid(warm_start, self._scene)
        ends = monotonic() + time_limit
        crashed: list[str] = []
        found = list(self._found(warm_start, ends, time_limit, crashed))
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
            iterations=sum(each.iterations for _, each in found),
            seconds=sum((each.seconds for _, each in found), Seconds()),
            options=asdict(self._options),
            starts=attempts if len(found) > 1 else best.starts,
        )

    def _found(
        self, start: Trajectory | None, ends: float, time_limit: float, crashed: list[str]
    ) -> Iterator[tuple[str, Solution]]:
        """Yield the name and the solution of each pipeline, then of each solve on finer steps.

        Once a plan is found, an error in another way costs that way alone: a sentence in `crashed`.
        """
        scene = self._scene
        solved: list[Solution] = []
        by_modes = False  # whether mpcc has a plan that is followed
        refined: list[Solution] = []
        shot: Solution | None = None
        first_error: Exception | None = None
        for way in self._method.ways:
            if load_method(way.legs[0].method).accepts(scene) is not None:
                continue
            if way in _WITHOUT_MODES and by_modes and not self._options.all_ways:
                continue
            if way is _STRICT and solved:
                continue
            try:
                # Without a plan a pipeline may take half of the time that is left.
                now = monotonic()
                last = ends - _FOR_FINER * time_limit if solved else now + (ends - now) / 2.0
                found = _with_departure(scene, self._way(way, start, last))
            except MachineError:  # a full disk, for example, ends the other ways too
                raise
            except Exception as error:  # noqa: BLE001 - plans that are found are kept
                first_error = first_error or error
                crashed.append(_crash(way.name, error))
                continue
            solved += [found] if found.outcome is Outcome.SOLVED else []
            by_modes = by_modes or (way is _MODES and bool(solved) and _is_followed(found))
            yield way.name, found
            if way is SHOT:
                shot = found
                # This takes little time, and the ways after it may take all that is left.
                others = len(solved) - (found.outcome is Outcome.SOLVED)
                yield from self._kept(self._from_shot(found, solved, ends), crashed)
                refined = solved[others:]
            if monotonic() >= (last if solved else ends):
                break
        if first_error is not None and not solved:
            raise first_error
        legs = (*SHOT.legs, *_STRICT.legs)
        if not solved:
            if shot is not None:
                yield from self._kept(self._on_finer_steps(shot, SHOT.legs, ends), crashed)
            return
        cheapest = _cheapest(solved)
        if not _is_followed(cheapest) and not any(each is cheapest for each in refined):
            yield from self._kept(self._on_finer_steps(cheapest, legs, ends), crashed)

    def _from_shot(
        self, shot: Solution, solved: list[Solution], ends: float
    ) -> Iterator[tuple[str, Solution]]:
        """The contact modes of a shot, then the better of both on finer steps if it is not followed.

        solved: plans on the task's steps, to which this adds.
        """
        if shot.outcome is Outcome.SOLVED:
            found = _with_departure(
                self._scene, _solved(self._scene, _MODES_OF_SHOT, shot.trajectory, ends)[-1]
            )
            yield "shot+strict", found
            if found.outcome is Outcome.SOLVED:
                solved.append(found)
                shot = min(shot, found, key=lambda each: each.residuals[_DEPARTURE])
        if shot.outcome is Outcome.SOLVED and not any(map(_is_followed, solved)):
            yield from self._on_finer_steps(shot, SHOT.legs, ends)

    def _kept(
        self, found: Iterator[tuple[str, Solution]], crashed: list[str]
    ) -> Iterator[tuple[str, Solution]]:
        """Yield what is found until an error ends it, which costs no plan."""
        try:
            yield from found
        except MachineError:
            raise
        except Exception as error:  # noqa: BLE001 - plans that are found are kept
            crashed.append(_crash("finer steps", error))

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

    def _on_finer_steps(
        self, coarse: Solution, legs: Sequence[Leg], ends: float
    ) -> Iterator[tuple[str, Solution]]:
        """Solve on steps halved again and again, from the motion that followed the plan before.

        legs: tried in turn at each length, until a plan is clearly followed.
        """
        scene, found = self._scene, coarse
        for _ in range(self._options.halvings):
            plan = found.trajectory if found.outcome is Outcome.SOLVED else None
            if monotonic() >= ends or _is_clear(found):
                return
            motion = None if plan is None else motion_on_finer_steps(scene, plan, 2)
            scene = finer_scene(scene, 2)
            tried: list[Solution] = []
            for leg in legs:
                if load_method(leg.method).accepts(scene) is not None or monotonic() >= ends:
                    continue
                tried.append(_with_departure(scene, _solved(scene, leg, motion, ends)[-1]))
                yield f"{leg.method}, on {scene.task.steps} steps", tried[-1]
            if any(map(_is_clear, tried)):
                return
            found = min(tried, key=_order, default=found)


def _solved(scene: Scene, leg: Leg, start: Trajectory | None, ends: float) -> tuple[Solution, ...]:
    """Solve the stages of a leg. ends: time.monotonic() of the time limit."""
    alone = Pipeline(name=leg.method, title="", legs=(leg,))
    left = max(1e-3, ends - monotonic())
    return tuple(solve_stages(scene, alone, warm_start=start, time_limit=left))


def _with_departure(scene: Scene, found: Solution) -> Solution:
    """The same with the residual `departure` where it is solved, and as the motion of its inputs."""
    if found.outcome is not Outcome.SOLVED or found.trajectory is None:
        return found
    found, is_motion = _as_motion(scene, found, found.trajectory)
    assert found.trajectory is not None, "a motion is a plan"
    plan = found.trajectory
    departs = max(departure(scene, plan), contact_departure(scene, plan)) if is_motion else _LOST
    return replace(found, residuals={**found.residuals, _DEPARTURE: departs})


def _as_motion(scene: Scene, found: Solution, plan: Trajectory) -> tuple[Solution, bool]:
    """The plan, or the motion of its inputs if that differs; and whether it is such a motion.

    Where rounding decides when contact begins, or grows, a plan is not what its inputs do on its
    own grid: then that motion is corrected to end on the goal.
    """
    if plan.scheme is not Scheme.SEMI_IMPLICIT_EULER or plan.steps != scene.task.steps:
        return found, True
    kernel, near = load_kernel(scene), allowed_miss(scene)
    if is_motion(scene, kernel, plan.u, plan.q):
        return found, True
    shot = corrected(scene, kernel, plan.u, near)
    settled = off_the_edge(scene, kernel, shot, near) if shot.has_arrived else None
    if settled is None:
        return found, False
    return replace(
        found, trajectory=plan_of(scene, settled.rollout, settled.u), cost=settled.cost
    ), True


def _stable(scene: Scene, halvings: int) -> Scene:
    """The task on steps halved until they are stable in contact, at most so often; itself if they are."""
    for halving in range(halvings + 1):
        finer = finer_scene(scene, 2**halving) if halving else scene
        if step_stability(finer).is_stable:
            return finer
    return scene


def _crash(way: str, error: Exception) -> str:
    """Return a sentence on an error within a pipeline."""
    return f"{way} ended with an error ({type(error).__name__}: {str(error).rstrip('.')})."


def _is_followed(found: Solution) -> bool:
    return found.residuals.get(_DEPARTURE, 0.0) <= 1.0


def _is_clear(found: Solution) -> bool:
    return found.outcome is Outcome.SOLVED and found.residuals[_DEPARTURE] <= _CLEARLY


def _order(found: Solution) -> tuple[bool, float]:
    """Sorts solved plans first, and of these the one that departs least."""
    is_solved = found.outcome is Outcome.SOLVED
    return not is_solved, found.residuals.get(_DEPARTURE, 0.0)


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
        SHOT,
        find_pipeline("relaxed+strict"),
        find_pipeline("softplus_dc+strict"),
        RELAXED_WALK,
        SOFTLY_SHOT,
        _STRICT,
    )

    def session(self, scene: Scene, options: BestExactOptions, clock: Clock) -> Session:
        """Open a session; the sessions of the pipelines are opened one after the other."""
        return BestExactSession(self, scene, options)


METHOD = BestExact()
