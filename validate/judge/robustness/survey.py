"""What a campaign asks of every plan that holds: in how many perturbed worlds it arrives, and of which perturbation it takes least.

    found = survey(scene, plan, limits, False)
    found.alone.share, found.weakest, found.sizes

The same worlds for every plan of a scene, so that two of them differ by no luck of the draw. First failures are not looked for along every perturbation to
their end, as `robustness` does: only where a plan fails at a smaller size than along those before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.robustness.robustness import FARTHEST, OF_FEEDBACK, Share, check_by_reference, first_failure
from validate.judge.robustness.trials import Arena, SceneArena
from validate.judge.robustness.worlds import Perturbation, PerturbationKind, draw, moved, perturbations

# Worlds of a plan: shares are told to 6 %. Where they cost more internal steps than this in all, half as many, and so on down to the fewest.
SAMPLES, FEWEST, MOST_STEPS = 256, 32, 2**19
SEED = 0


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was found of a plan.

    alone, feedback: how many worlds it arrives in, None where the plan has no states to feed back; checked, differ: worlds that the reference was asked about too,
    and in how many it says otherwise; weakest: the perturbation by itself of which the plan takes the fewest sizes (`""`: it takes all up to 64), how far [unit], and
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


@dataclass
class _Weakest:
    """The smallest first failure until now."""

    arena: Arena
    sizes: float = FARTHEST
    found: dict[str, Any] = field(default_factory=dict)

    def along(self, cause: Perturbation, direction: int) -> None:
        """Look along a perturbation, one way, whether the plan fails at a smaller size, and at which. Raises FmuError."""
        failures: dict[float, str] = {}

        def ratio(size: float) -> float:
            trial = self.arena.trial(moved(self.arena.nominal, [cause], np.array([direction * size])), feedback=self.arena.followed)
            if not trial.arrives:
                failures[size] = trial.fails_by
            return trial.ratio

        tried = min(self.sizes, cause.below if direction < 0 else cause.above)
        if tried > 0.0 and ratio(tried) > 1.0 and (sizes := first_failure(ratio, tried)) is not None:
            amount = direction * sizes * cause.size
            self.sizes = sizes
            self.found = {"weakest": cause.name, "sizes": sizes, "amount": amount, "unit": cause.unit, "by": failures[min(failures)]}


def survey(scene: Scene, plan: Trajectory, limits: Mapping[str, float], followed: bool) -> Survey:
    """Try a plan that holds in the worlds of a campaign.

    Parameters
    ----------
    limits : what the judge held the plan to, by metric
    followed : whether it holds only with feedback

    Raises
    ------
    TrajectoryError : where the scene limits neither an end nor a cost, or nothing of it can be perturbed.
    FmuError, MachineError : in one sentence.
    """
    plan = plan.from_zero()
    causes = perturbations(scene, plan)
    with SceneArena.of(scene, plan, limits, followed=followed) as arena:
        samples = SAMPLES
        while samples > FEWEST and samples * arena.fineness * plan.steps > MOST_STEPS:
            samples //= 2
        worlds, shares, checks = draw(causes, samples, SEED), [], []
        for feedback in (False,) if arena.feedback is None else (False, True):
            numbers = range(samples // OF_FEEDBACK if feedback else samples)
            ratios = [arena.trial(worlds.world(number, arena.nominal), feedback=feedback).ratio for number in numbers]
            shares.append(Share(arrived=sum(ratio <= 1.0 for ratio in ratios), samples=len(ratios)))
            checks.append(check_by_reference(arena, worlds, ratios, feedback))
        weakest = _Weakest(arena)
        for cause in causes:
            if cause.kind is not PerturbationKind.NOISE:
                for direction in (-1, 1):
                    weakest.along(cause, direction)
    return Survey(
        alone=shares[0], feedback=shares[1] if len(shares) > 1 else None, checked=sum(item.count for item in checks), differ=sum(len(item.differ) for item in checks),
        **weakest.found,
    )  # fmt: skip
