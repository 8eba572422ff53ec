"""Robustness of a plan: its share of perturbed worlds, and the perturbation it tolerates least.

    result = robustness("three_cart", "plan.csv", samples=1000)
    result.alone.share, result.alone.interval, result.weakest
    survey(scene, plan, limits, False).weakest      # short form, for campaigns

Inputs alone and with feedback are separate. The reference repeats some trials; differences are
counted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from models.catalog import as_scene
from models.errors import TrajectoryError
from models.results.robustness import (
    Checked,
    FirstFailure,
    Perturbation,
    PerturbationKind,
    RobustnessRecord,
    Share,
    Survey,
    Way,
)
from models.results.verdict import Verdict
from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.judgement import Judgement, WiredFmu, as_trajectory, judge
from validate.judge.robustness.trials import (
    Arena,
    FmuArena,
    SceneArena,
    WorldTrial,
    asked_limits,
)
from validate.judge.robustness.worlds import Draw, draw, moved, perturbations

SAMPLES = 1000
MOST = 1_000_000
# One of this many worlds is repeated by the reference.
_EVERY = 50
# Smallest number of repeated worlds.
_FEWEST = 10
# Largest number of repeated worlds.
_MOST_CHECKED = 200
# First size of one perturbation.
_FIRST = 1 / 32
# Factor between sizes.
_FACTOR = math.sqrt(2.0)
# Largest size.
FARTHEST = 64.0
# Relative width of the bisected interval.
_WITHIN = 0.01
# Fewest worlds.
_LEAST = 10
# One of this many worlds is tried with feedback too, which is ten times as expensive.
OF_FEEDBACK = 4


@dataclass(kw_only=True, eq=False)
class TriedWay(Way):
    """A way to drive the plan; tried: per world the largest metric, as a share of its limit."""

    tried: list[float] = field(default_factory=list)


@dataclass(kw_only=True, eq=False)
class Robustness(RobustnessRecord):
    """Measurements of a plan; points (samples, causes): worlds in sizes."""

    judgement: Judgement
    points: np.ndarray
    ways: list[TriedWay] = field(default_factory=lambda: [TriedWay(name="inputs alone")])  # type: ignore[assignment] - a list that only this module fills


def robustness(
    scene: Scene | WiredFmu | str | Path,
    plan: Any = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
    kinds: Sequence[PerturbationKind | str] = tuple(PerturbationKind),
    anyway: bool = False,
    hold: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Robustness:
    """Measure the robustness of a plan.

    Parameters
    ----------
    scene, plan, hold
        As for `judge`; or a wired external FMU, which has its plan.
    samples
        Number of worlds, from 10 to 10^6.
    seed
        The same seed gives bitwise the same worlds and numbers.
    kinds
        Perturbations: parameters, start, gain, noise, delay, or names of single ones.
    anyway
        Measure a plan that does not hold, too.
    tell
        Receives a sentence at each part of the work.

    Returns
    -------
    Robustness
        After Ctrl-C the measurements so far, with `complete` False.

    Raises
    ------
    SceneError, TrajectoryError, FmuError, MachineError
        In one sentence.
    """
    if not isinstance(samples, int) or not _LEAST <= samples <= MOST:
        raise TrajectoryError(
            f"samples: {samples} must be a whole number from {_LEAST} to {MOST}; {SAMPLES} give a share to 3 %."
        )
    if not isinstance(seed, int) or seed < 0:
        raise TrajectoryError(f"seed: {seed} must be a whole number of at least 0.")
    if isinstance(scene, WiredFmu):
        causes, judgement = perturbations(scene.foreign.model, scene.plan, kinds), scene.judge()
        arena_of = partial(FmuArena.of, scene)
    else:
        subject = as_scene(scene)
        trajectory = as_trajectory(plan, subject, hold=hold)
        if trajectory is None:
            raise TrajectoryError("plan: this solution has none, so there is nothing to try.")
        trajectory = trajectory.from_zero()
        causes, judgement = perturbations(subject, trajectory, kinds), judge(subject, trajectory)
        assert judgement.replay is not None
        arena_of = partial(SceneArena.of, subject, trajectory)
    # On an FMU without a goal a plan is consistent at best; its own motion is then the goal.
    holds = judgement.holds or (
        isinstance(scene, WiredFmu) and judgement.verdict is Verdict.CONSISTENT
    )
    if not holds and not anyway:
        raise TrajectoryError(
            f"plan: it does not hold to begin with ({judgement.score.sentence.rstrip('.')}). Measure its robustness all the same with --anyway (anyway=True)."
        )
    began, worlds = time.process_time(), draw(causes, samples, seed)
    result = Robustness(
        scene=judgement.scene.name, verdict=judgement.verdict, judgement=judgement, causes=causes,
        seed=seed, points=worlds.points,
    )  # fmt: skip
    with arena_of(asked_limits(judgement.score), followed=result.followed) as arena:
        try:
            _measure(arena, worlds, result, tell)
        except KeyboardInterrupt:
            result.complete = False
        result.fineness, result.trials, result.seconds = (
            arena.fineness,
            arena.trials,
            time.process_time() - began + arena.seconds,
        )
    return result


def _measure(arena: Arena, worlds: Draw, result: Robustness, tell: Callable[[str], None]) -> None:
    samples = len(worlds.points)
    for feedback in (False,) if arena.feedback is None else (False, True):
        way, count = (
            (TriedWay(name="with feedback"), max(_LEAST, samples // OF_FEEDBACK))
            if feedback
            else (result.ways[0], samples)
        )
        tell(f"{count} worlds, {way.name}")
        try:
            for number in range(count):
                trial = arena.trial(worlds.world(number, arena.nominal), feedback=feedback)
                way.tried.append(trial.ratio)
                if way not in result.ways:
                    result.ways.append(way)
                if not trial.arrives:
                    way.fails_by[trial.fails_by] = way.fails_by.get(trial.fails_by, 0) + 1
        finally:  # after Ctrl-C too
            way.share = Share.of(way.tried)
    for feedback, way in enumerate(result.ways):
        tell(f"some of these {arena.by} too")
        way.checked = check_by_reference(arena, worlds, way.tried, bool(feedback))
    for cause in worlds.causes:
        if cause.kind is not PerturbationKind.NOISE:
            tell(f"{cause.name} by itself")
            result.failures.extend(_failures(arena, cause))


def check_by_reference(
    arena: Arena, worlds: Draw, ratios: Sequence[float], feedback: bool
) -> Checked:
    """Repeat evenly chosen worlds by the reference; ratios: of each world by the everyday replay.

    Raises FmuError, MachineError.
    """
    count = min(len(ratios), max(_FEWEST, min(_MOST_CHECKED, len(ratios) // _EVERY)))
    numbers = np.unique(np.linspace(0, len(ratios) - 1, count).round().astype(int)).tolist()
    differ, largest = [], 0.0
    for number in numbers:
        ratio = arena.checked(worlds.world(number, arena.nominal), feedback=feedback).ratio
        if (ratio <= 1.0) is not (ratios[number] <= 1.0):
            differ.append((number, ratios[number], ratio))
        if math.isfinite(ratio) and math.isfinite(ratios[number]):
            largest = max(largest, abs(ratio - ratios[number]))
    return Checked(
        count=len(numbers), differ=tuple(differ), largest_difference=largest, by=arena.by
    )


def _at(arena: Arena, cause: Perturbation, size: float) -> WorldTrial:
    return arena.trial(moved(arena.nominal, [cause], np.array([size])), feedback=arena.followed)


def _along(
    arena: Arena, cause: Perturbation, direction: int, largest: float
) -> tuple[float, WorldTrial] | None:
    """Return the size of the first failure in one direction, and its trial, or None."""
    cases: dict[float, WorldTrial] = {}

    def ratio(size: float) -> float:
        cases[size] = _at(arena, cause, direction * size)
        return cases[size].ratio

    sizes = first_failure(ratio, largest)
    return (
        None
        if sizes is None
        else (
            sizes,
            cases[
                min(size for size, trial in cases.items() if size >= sizes and not trial.arrives)
            ],
        )
    )


def _failures(arena: Arena, cause: Perturbation) -> Iterable[FirstFailure]:
    for direction in (1,) if cause.below == 0.0 else (-1, 1):
        tried = min(FARTHEST, cause.above if direction > 0 else cause.below)
        sizes, failed = _along(arena, cause, direction, tried) or (None, None)
        yield FirstFailure(
            cause=cause,
            direction=direction,
            sizes=sizes,
            amount=None if sizes is None else direction * sizes * cause.size,
            tried=tried,
            by="" if failed is None else failed.fails_by,
        )


def first_failure(ratio: Callable[[float], float], largest: float) -> float | None:
    """Return the smallest size at which a share exceeds 1, to 1 %.

    Sizes grow by a factor, then the last interval is halved.

    Parameters
    ----------
    ratio
        Share at a size.
    largest
        Largest size to try.

    Returns
    -------
    float or None
        0 if the share exceeds 1 without a perturbation, None if nowhere.
    """
    if ratio(0.0) > 1.0:
        return 0.0
    low, high = 0.0, min(_FIRST, largest)
    while ratio(high) <= 1.0:
        if high >= largest:
            return None
        low, high = high, min(high * _FACTOR, largest)
    while high - low > _WITHIN * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if ratio(middle) > 1.0 else (middle, high)
    return (low + high) / 2.0


# Worlds of a campaign's plan, for shares to 6 %.
SURVEYED = 256
# Smallest number of such worlds.
FEWEST = 32
# Largest number of internal steps; beyond it worlds are halved, down to FEWEST.
MOST_STEPS = 2**19

SEED = 0


def survey(scene: Scene, plan: Trajectory, limits: Mapping[str, float], followed: bool) -> Survey:
    """Try a plan that holds in the worlds of a campaign, the same for every plan of a scene.

    A perturbation is followed to its first failure only if it fails at a smaller size than those
    before.

    Parameters
    ----------
    limits
        The judge's limits by metric.
    followed
        True if the plan holds only with feedback.

    Raises
    ------
    TrajectoryError
        If the scene limits neither an end nor a cost, or nothing can be perturbed.
    FmuError, MachineError
        In one sentence.
    """
    plan = plan.from_zero()
    causes = perturbations(scene, plan)
    with SceneArena.of(scene, plan, limits, followed=followed) as arena:
        samples = SURVEYED
        while samples > FEWEST and samples * arena.fineness * plan.steps > MOST_STEPS:
            samples //= 2
        worlds, shares, checks = draw(causes, samples, SEED), [], []
        for feedback in (False,) if arena.feedback is None else (False, True):
            numbers = range(samples // OF_FEEDBACK if feedback else samples)
            ratios = [
                arena.trial(worlds.world(number, arena.nominal), feedback=feedback).ratio
                for number in numbers
            ]
            shares.append(Share.of(ratios))
            checks.append(check_by_reference(arena, worlds, ratios, feedback))
        smallest, weakest = FARTHEST, {}
        for cause, direction in product(
            (item for item in causes if item.kind is not PerturbationKind.NOISE), (-1, 1)
        ):
            tried = min(smallest, cause.below if direction < 0 else cause.above)
            if (
                tried > 0.0
                and not _at(arena, cause, direction * tried).arrives
                and (first := _along(arena, cause, direction, tried))
            ):
                smallest, failed = first
                amount = direction * smallest * cause.size
                weakest = {
                    "weakest": cause.name,
                    "sizes": smallest,
                    "amount": amount,
                    "unit": cause.unit,
                    "by": failed.fails_by,
                }
    return Survey(
        alone=shares[0], feedback=shares[1] if len(shares) > 1 else None,
        checked=sum(item.count for item in checks), differ=sum(len(item.differ) for item in checks),
        **weakest,
    )  # fmt: skip
