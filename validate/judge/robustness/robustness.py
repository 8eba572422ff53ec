"""How much a plan can take: in what share of perturbed worlds it arrives, and which perturbation it takes least of.

    found = robustness("three_cart", "plan.csv", samples=1000)
    found.alone.share, found.alone.interval, found.weakest
    # in short, as a campaign asks it of every plan that holds
    survey(scene, plan, limits, False).weakest

Inputs alone and with feedback apart. Worlds come from validate.judge.robustness.worlds, trials from
validate.judge.robustness.trials; a sample is tried once more by the reference, and what differs is
counted.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from models.catalog import as_scene
from models.errors import TrajectoryError
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
from validate.judge.robustness.worlds import (
    Draw,
    Perturbation,
    PerturbationKind,
    draw,
    moved,
    perturbations,
)
from validate.judge.score.verdict import Verdict

SAMPLES = 1000
MOST = 1_000_000
# One of so many worlds is tried by the reference too, within these bounds.
_EVERY = 50
_FEWEST = 10
_MOST_CHECKED = 200
# Sizes of one perturbation: from the first, by this factor up to the last, then bisected to 1 %.
_FIRST = 1 / 32
_FACTOR = math.sqrt(2.0)
FARTHEST = 64.0
_WITHIN = 0.01
_Z95 = 1.959963984540054
# One of so many worlds is tried with feedback too, which costs ten times as much.
_LEAST = 10
OF_FEEDBACK = 4


@dataclass(frozen=True, kw_only=True)
class Share:
    """How many of the worlds a plan arrives in; interval: Wilson's, of 95 %."""

    arrived: int
    samples: int

    @property
    def share(self) -> float:
        """The part that arrives [-]; 0 of none."""
        return self.arrived / max(self.samples, 1)

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end (Wilson, 1927)."""
        if not self.samples:
            return 0.0, 1.0
        n, share, z2 = self.samples, self.share, _Z95**2
        middle, half = (
            share + z2 / (2 * n),
            _Z95 * math.sqrt(share * (1 - share) / n + z2 / (4 * n * n)),
        )
        low, high = ((middle + sign * half) / (1 + z2 / n) for sign in (-1, 1))
        return (0.0 if self.arrived == 0 else low), (1.0 if self.arrived == n else high)


@dataclass(frozen=True, kw_only=True)
class FirstFailure:
    """One perturbation, one way, driven as the plan holds: the size at which the plan first fails.

    direction: -1 or 1; sizes: in sizes of the perturbation, None where it arrives up to `tried`;
        amount: the same in the perturbation's unit; by: what fails there.
    """

    cause: Perturbation
    direction: int
    sizes: float | None
    tried: float
    by: str

    @property
    def amount(self) -> float | None:
        """By how much it is moved there [unit of the perturbation]."""
        return None if self.sizes is None else self.direction * self.sizes * self.cause.size


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Worlds that were tried once more, by the reference or as `by` says: how many, and of those that differ the number of the world and both shares."""

    count: int
    differ: tuple[tuple[int, float, float], ...]
    largest_difference: float
    by: str


@dataclass(kw_only=True, eq=False)
class Way:
    """A way to drive the plan, "inputs alone" or "with feedback": how many worlds fail by what, and what was checked.

    tried: of each world the largest of what is asked, as a share of its limit.
    """

    name: str
    tried: list[float] = field(default_factory=list)
    fails_by: Counter[str] = field(default_factory=Counter)
    checked: Checked | None = None

    @property
    def share(self) -> Share:
        """How many arrive."""
        return Share(arrived=sum(ratio <= 1.0 for ratio in self.tried), samples=len(self.tried))


@dataclass(kw_only=True, eq=False)
class Robustness:
    """What was measured of a plan, and grows while it is measured.

    complete: False where that was interrupted.

    fineness: internal steps a plan step; ways: inputs alone, then with feedback; trials: replays in
        all; seconds: CPU time [s]; points (samples, causes): the worlds in sizes.
    """

    judgement: Judgement
    causes: tuple[Perturbation, ...]
    seed: int
    points: np.ndarray
    ways: list[Way] = field(default_factory=lambda: [Way(name="inputs alone")])
    failures: list[FirstFailure] = field(default_factory=list)
    fineness: int = 0
    trials: int = 0
    seconds: float = 0.0
    complete: bool = True

    @property
    def scene(self) -> str:
        """Its name."""
        return self.judgement.scene.name

    @property
    def verdict(self) -> Verdict:
        """Of the plan in the scene's own world."""
        return self.judgement.verdict

    @property
    def followed(self) -> bool:
        """Whether first failures are those with feedback: the plan holds only with it."""
        return self.verdict is Verdict.HOLDS_WITH_FEEDBACK

    @property
    def alone(self) -> Way:
        """Inputs alone."""
        return self.ways[0]

    @property
    def feedback(self) -> Way | None:
        """With feedback.

        None where the plan has no states to feed back, or the work was interrupted before.
        """
        return self.ways[1] if len(self.ways) > 1 else None

    @property
    def weakest(self) -> FirstFailure | None:
        """The perturbation of which the plan takes the fewest sizes."""
        return min(
            (item for item in self.failures if item.sizes is not None),
            key=lambda item: item.sizes or 0.0,
            default=None,
        )


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
    """Measure how much a plan can take.

    Parameters
    ----------
    scene, plan, hold : as `judge` takes them; or somebody's FMU, which has its plan
    samples : worlds, from 10 to 10^6
    seed : of the worlds; the same seed gives the same worlds and the same numbers, to the bit
    kinds : what is perturbed: parameters, start, gain, noise, delay, or single ones by their names
    anyway : measure a plan too that does not hold to begin with
    tell : is called with a sentence at each part of the work

    Returns
    -------
    Robustness
        after Ctrl-C what was measured until then, with `complete` False.

    Raises
    ------
    SceneError, TrajectoryError, FmuError, MachineError : in one sentence.
    """
    if not isinstance(samples, int) or not _LEAST <= samples <= MOST:
        raise TrajectoryError(
            f"samples: {samples} must be a whole number from {_LEAST} to {MOST}; {SAMPLES} tell a share to 3 %."
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
        assert judgement.replay is not None  # of a plan
        arena_of = partial(SceneArena.of, subject, trajectory)
    # The plan of an FMU without a goal is consistent at best: then its own motion is what is asked.
    holds = judgement.holds or (
        isinstance(scene, WiredFmu) and judgement.verdict is Verdict.CONSISTENT
    )
    if not holds and not anyway:
        raise TrajectoryError(
            f"plan: it does not hold to begin with ({judgement.score.sentence.rstrip('.')}); what it takes beyond is measured with --anyway (anyway=True)."
        )
    began, worlds = time.process_time(), draw(causes, samples, seed)
    found = Robustness(judgement=judgement, causes=causes, seed=seed, points=worlds.points)
    with arena_of(asked_limits(judgement.score), followed=found.followed) as arena:
        try:
            _measure(arena, worlds, found, tell)
        except KeyboardInterrupt:
            found.complete = False
        found.fineness, found.trials, found.seconds = (
            arena.fineness,
            arena.trials,
            time.process_time() - began + arena.seconds,
        )
    return found


def _measure(arena: Arena, worlds: Draw, found: Robustness, tell: Callable[[str], None]) -> None:
    samples = len(worlds.points)
    for feedback in (False,) if arena.feedback is None else (False, True):
        way, count = (
            (Way(name="with feedback"), max(_LEAST, samples // OF_FEEDBACK))
            if feedback
            else (found.alone, samples)
        )
        tell(f"{count} worlds, {way.name}")
        for number in range(count):
            trial = arena.trial(worlds.world(number, arena.nominal), feedback=feedback)
            way.tried.append(trial.ratio)
            if way not in found.ways:
                found.ways.append(way)
            if not trial.arrives:
                way.fails_by[trial.fails_by] += 1
    for feedback, way in enumerate(found.ways):
        tell(f"some of these {arena.by} too")
        way.checked = check_by_reference(arena, worlds, way.tried, bool(feedback))
    for cause in worlds.causes:
        if cause.kind is not PerturbationKind.NOISE:
            tell(f"{cause.name} by itself")
            found.failures.extend(_failures(arena, cause))


def check_by_reference(
    arena: Arena, worlds: Draw, ratios: Sequence[float], feedback: bool
) -> Checked:
    """Every so manieth world again by the reference. ratios: of each world tried, by the everyday replay. Raises FmuError, MachineError."""
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
    """The plan in the model's own world but for one perturbation, driven as it holds."""
    return arena.trial(moved(arena.nominal, [cause], np.array([size])), feedback=arena.followed)


def _along(
    arena: Arena, cause: Perturbation, direction: int, largest: float
) -> tuple[float, WorldTrial] | None:
    """The size at which the plan first fails along one perturbation, one way, and the trial of the smallest move that fails; None where there is none."""
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
    """Both ways along one perturbation."""
    for direction in (1,) if cause.below == 0.0 else (-1, 1):
        tried = min(FARTHEST, cause.above if direction > 0 else cause.below)
        sizes, failed = _along(arena, cause, direction, tried) or (None, None)
        yield FirstFailure(
            cause=cause,
            direction=direction,
            sizes=sizes,
            tried=tried,
            by="" if failed is None else failed.fails_by,
        )


def first_failure(ratio: Callable[[float], float], largest: float) -> float | None:
    """The smallest size at which a share exceeds 1, to 1 %: sizes rise by a factor until it does, then the last interval is halved.

    Parameters
    ----------
    ratio : the share at a size
    largest : size to which it is looked for

    Returns
    -------
    the size, 0 where the share exceeds 1 without any; None where it does nowhere.
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


# Worlds of a plan of a campaign: shares are told to 6 %. Where they cost more internal steps than
# this in all, half as many, and so on down to the fewest.
SURVEYED = 256
FEWEST = 32
MOST_STEPS = 2**19
SEED = 0


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was found of a plan.

    alone, feedback: how many worlds it arrives in, None where the plan has no states to feed back;
        checked, differ: worlds that the reference was asked about too,
    and in how many it says otherwise; weakest: the perturbation by itself of which the plan takes
        the fewest sizes (`""`: it takes all up to 64), how far [unit], and
    the metric by which it fails there - with feedback where it holds only so.
    """

    alone: Share
    feedback: Share | None
    checked: int
    differ: int
    weakest: str = ""
    sizes: float | None = None
    amount: float | None = None
    unit: str = ""
    by: str = ""


def survey(scene: Scene, plan: Trajectory, limits: Mapping[str, float], followed: bool) -> Survey:
    """Try a plan that holds in the worlds of a campaign.

    They are the same for every plan of a scene, so that two of them differ by no luck of the draw.
    First failures are not looked for along every perturbation to their end, as `robustness` does:
    only where a plan fails at a smaller size than along those before.

    Parameters
    ----------
    limits : what the judge held the plan to, by metric
    followed : whether it holds only with feedback

    Raises
    ------
    TrajectoryError : where the scene limits neither an end nor a cost, or nothing of it can be
        perturbed.
    FmuError, MachineError : in one sentence.
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
            shares.append(Share(arrived=sum(ratio <= 1.0 for ratio in ratios), samples=len(ratios)))
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
