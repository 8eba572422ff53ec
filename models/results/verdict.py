"""Verdict on a plan: its questions, their answers, and the metrics that decide them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Literal, TypeAlias

from models.results.fields import OrInfinite, Result


class Verdict(StrEnum):
    """Verdict on a plan, as the word of tables, files and sentences.

    - `holds`: all questions are answered yes for the inputs alone.
    - `holds with feedback`: only with limited feedback.
    - `violates`: one certainly fails.
    - `undecided`: none fails, one is undecided.
    - `no plan`: nothing to judge.
    - `not applicable`: the method does not apply, or neither claims nor goals exist.
    - `consistent`: nothing is wrong, and there is no goal.
    """

    HOLDS = "holds"
    HOLDS_WITH_FEEDBACK = "holds with feedback"
    VIOLATES = "violates"
    UNDECIDED = "undecided"
    NO_PLAN = "no plan"
    NOT_APPLICABLE = "not applicable"
    CONSISTENT = "consistent"

    @property
    def is_good(self) -> bool:
        """Return whether the plan holds, with or without feedback."""
        return self in HOLD


# Verdicts of plans that hold.
HOLD = (Verdict.HOLDS, Verdict.HOLDS_WITH_FEEDBACK)
# Prefix of metrics with feedback.
TRACKED = "tracked_"
# Prefix of metrics of the feedback's effort.
FEEDBACK = "feedback_"


class Question(Enum):
    """Question about a plan, in this order; `JUDGE` is about the replay, `SHOWN` is none."""

    TASK = "Is it a plan of this task?"
    GOAL = "Does it say that it reaches the goal?"
    FORCES = "Is what it claims of its velocities and forces physical?"
    MOTION = "Do its inputs give its motion, and the goal?"
    POSSIBLE = "Is the replayed motion possible?"
    SCHEME = "Does it solve its own discrete equations?"
    JUDGE = "Is the judge well?"
    SHOWN = ""

    @property
    def number(self) -> int | None:
        """Return 1 to 6, None for the last two."""
        place = list(Question).index(self) + 1
        return place if place <= 6 else None


Answer: TypeAlias = Literal["yes", "no", "undecided", "not asked"]


@dataclass(frozen=True, kw_only=True)
class Metric(Result):
    """One metric of a plan, or one figure of a check.

    - value: None if not measured, with `reason`.
    - error: by the replay's error, infinite if unknown.
    - limit: of the scene or the metric, with `reason`, None if not judged.
    - ok: None if undecided or without a limit.
    - default: the limit is the metric's own.
    - at_least: a lower limit.
    """

    name: str
    question: Question = Question.SHOWN
    value: float | None
    unit: str
    meaning: str
    error: OrInfinite = 0.0
    limit: float | None = None
    reason: str = ""
    ok: bool | None = None
    default: bool = True
    at_least: bool = False

    @property
    def is_judged(self) -> bool:
        """Return whether the metric has a limit."""
        return self.limit is not None

    @property
    def has_known_error(self) -> bool:
        """Return whether the error is known."""
        return math.isfinite(self.error)
