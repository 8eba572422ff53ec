"""What the judge says: figures, and a verdict with the sentence that decided it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """`holds`: every limited figure is below its limit; `violates`: at least one is above; `not resolved`: none is above, but one
    could not be measured or is too close to its limit for the replay's own error; `no plan`: there is nothing to judge."""

    HOLDS = "holds"
    VIOLATES = "violates"
    NOT_RESOLVED = "not resolved"
    NO_PLAN = "no plan"


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of the score.

    value: None where it could not be measured (`reason` says why); error: how wrong the value may be by the replay's own error
    (0 for figures of the plan alone); limit and its reason from the scene, or None;
    ok: value against limit, None without a limit, a value, or resolution; resolved: False where 10 * error reaches from the value to the limit.
    """

    name: str
    value: float | None
    unit: str
    meaning: str
    error: float = 0.0
    limit: float | None = None
    reason: str = ""
    ok: bool | None = None
    resolved: bool = True

    @property
    def is_judged(self) -> bool:
        return self.limit is not None


@dataclass(frozen=True, kw_only=True)
class Score:
    """All figures of one plan and the verdict.

    contact: verdict on the figures of contact physics alone (the plan's forces, and what its inputs do under the true law on the
    plan's own grid); grid: verdict on the replay in continuous time, where the time step's own error shows too. `why` says which figure decided.
    judged: the replay that limits are for, "open" (the plan's inputs alone) or "tracked" (with feedback around the plan).
    """

    figures: tuple[Figure, ...]
    verdict: Verdict
    why: str
    contact: Verdict
    grid: Verdict
    judged: str = "open"

    def figure(self, name: str) -> Figure | None:
        return next((figure for figure in self.figures if figure.name == name), None)

    def value(self, name: str) -> float | None:
        """The value of a figure; None if it was not measured."""
        figure = self.figure(name)
        return None if figure is None else figure.value
