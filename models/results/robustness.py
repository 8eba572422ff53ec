"""Robustness of a plan: of one plan by `validate robust` (docs/robustness.md), or in a campaign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from models.results.fields import OrInfinite, Result
from models.results.verdict import Verdict

# Two-sided 95 % quantile of the normal distribution.
_Z95 = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class Share(Result):
    """Number of perturbed worlds in which a plan arrives, with Wilson's 95 % interval."""

    arrived: int
    samples: int
    share: float
    interval: tuple[float, float]

    @classmethod
    def of(cls, ratios: Sequence[float]) -> Share:
        """Return the share of worlds whose largest metric is at most its limit.

        ratios: that metric over its limit, by world. The interval is Wilson's (1927).
        """
        n, arrived = len(ratios), sum(ratio <= 1.0 for ratio in ratios)
        if not n:
            return cls(arrived=0, samples=0, share=0.0, interval=(0.0, 1.0))
        share, z2 = arrived / n, _Z95**2
        middle = share + z2 / (2 * n)
        half = _Z95 * math.sqrt(share * (1 - share) / n + z2 / (4 * n * n))
        low, high = ((middle + sign * half) / (1 + z2 / n) for sign in (-1, 1))
        interval = (0.0 if arrived == 0 else low, 1.0 if arrived == n else high)
        return cls(arrived=arrived, samples=n, share=share, interval=interval)

    @property
    def words(self) -> str:
        """Return `71.5 % (68.6 to 74.2 %) of 1,000 worlds`."""
        if not self.samples:
            return "none, as no world was tried"
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %) of {self.samples:,} worlds"


class PerturbationKind(StrEnum):
    """Kind of a perturbation."""

    PARAMETERS = "parameters"
    START = "start"
    GAIN = "gain"
    NOISE = "noise"
    DELAY = "delay"


@dataclass(frozen=True, kw_only=True)
class Perturbation(Result):
    """One uncertain number of a world.

    - index: place within its kind.
    - nominal, size: value and uncertainty [unit].
    - below, above: largest moves down and up, in sizes.
    """

    kind: PerturbationKind
    name: str
    index: int
    nominal: float
    size: float
    unit: str
    reason: str
    below: OrInfinite = math.inf
    above: OrInfinite = math.inf


@dataclass(frozen=True, kw_only=True)
class FirstFailure(Result):
    """The size of one perturbation, in one direction, at which the plan first fails.

    - sizes: in sizes of the perturbation, None if the plan arrives up to `tried`.
    - amount: the perturbation there [unit].
    - by: the failing metric. The plan is driven as it holds.
    """

    cause: Perturbation
    direction: int
    sizes: float | None
    amount: float | None
    tried: float
    by: str

    @property
    def words(self) -> str:
        """Return `c by -0.0833 N s/m (0.83 of its size)`."""
        of = "" if self.cause.unit == "1" else f" {self.cause.unit}"
        return f"{self.cause.name} by {self.amount:+.3g}{of} ({self.sizes:.2f} of its size)"


@dataclass(frozen=True, kw_only=True)
class Checked(Result):
    """Repeated worlds; differ: (number, share by the everyday replay, share by the reference).

    A share is infinite if the motion ended early.
    """

    count: int
    differ: tuple[tuple[int, OrInfinite, OrInfinite], ...]
    largest_difference: float
    by: str


@dataclass(kw_only=True, eq=False)
class Way(Result):
    """One way to drive the plan: "inputs alone" or "with feedback".

    fails_by: number of worlds by failing metric or ending.
    """

    name: str
    share: Share = field(default_factory=lambda: Share.of(()))
    fails_by: dict[str, int] = field(default_factory=dict)
    checked: Checked | None = None

    @property
    def fails(self) -> str:
        """Return the failing metrics, the most frequent first, or ""."""
        counts = sorted(self.fails_by.items(), key=lambda item: -item[1])
        return "; ".join(f"{name.replace('_', ' ')} in {count:,}" for name, count in counts)


@dataclass(kw_only=True, eq=False)
class RobustnessRecord(Result):
    """Robustness of a plan, filled as it is measured; complete is False if interrupted.

    - verdict: in the scene's own world.
    - fineness: internal steps per plan step.
    - ways: inputs alone, then with feedback.
    - trials: replays in all.
    - seconds: CPU time [s].
    """

    scene: str
    verdict: Verdict
    seed: int
    causes: tuple[Perturbation, ...]
    ways: list[Way]
    failures: list[FirstFailure] = field(default_factory=list)
    fineness: int = 0
    trials: int = 0
    seconds: float = 0.0
    complete: bool = True

    @property
    def followed(self) -> bool:
        """Return whether failures are those with feedback, as the plan holds only with it."""
        return self.verdict is Verdict.HOLDS_WITH_FEEDBACK

    @property
    def alone(self) -> Way:
        """Return the results of the inputs alone."""
        return self.ways[0]

    @property
    def feedback(self) -> Way | None:
        """Return the results with feedback, None without states or if interrupted before."""
        return self.ways[1] if len(self.ways) > 1 else None

    @property
    def weakest(self) -> FirstFailure | None:
        """Return the failure at the smallest size."""
        return min(
            (item for item in self.failures if item.sizes is not None),
            key=lambda item: item.sizes or 0.0,
            default=None,
        )

    @property
    def summary(self) -> str:
        """Return the shares of worlds, and the weakest perturbation."""
        shares = "; ".join(f"{way.name} it arrives in {way.share.words}" for way in self.ways)
        weakest = "" if self.weakest is None else f" It takes least of: {self.weakest.words}."
        return f"{shares[:1].upper()}{shares[1:]}.{weakest}{'' if self.complete else ' The work was interrupted.'}"


@dataclass(frozen=True, kw_only=True)
class Survey(Result):
    """Robustness of a campaign's plan (validate.judge.robustness.survey).

    - alone, feedback: shares, feedback None without states.
    - checked, differ: worlds repeated by the reference, and those that differ.
    - weakest: the perturbation tolerated least ("": none fails up to 64 sizes), its amount [unit]
      and failing metric, with feedback if the plan needs it.
    - message: why the plan was not tried.
    - sources: digest of the code.
    """

    alone: Share | None = None
    feedback: Share | None = None
    checked: int = 0
    differ: int = 0
    weakest: str = ""
    sizes: float | None = None
    amount: float | None = None
    unit: str = ""
    by: str = ""
    message: str = ""
    sources: str = ""
