"""What the judge says: metrics, the answers to its questions, and a verdict with the sentence that decided it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Unmeasured(Exception):  # noqa: N818 - a metric that cannot be measured is a value with a reason
    """Raised within the measurement of a metric; the text is the reason."""


class LeavesBounds(Unmeasured):
    """The motion leaves every bound: there is no number, but the question is answered."""


class Contradicted(Unmeasured):
    """What somebody's FMU shows contradicts its map: the question stays open, for scenes and FMUs alike."""


class Verdict(Enum):
    """What is said of a plan; the value is the word that every table, file and sentence uses.

    `holds`: every question that was asked is answered yes for the inputs alone; `holds with feedback`: not so, but with limited feedback around the
    plan; `violates`: one surely is not; `undecided`: none surely is not, but one could not be decided; `no plan`: there is nothing to judge;
    `not applicable`: the method does not apply, or nothing is claimed and nothing asked; `consistent`: nothing is wrong, and the scene asks for nothing.
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
        """Whether the plan holds, by its inputs alone or with feedback."""
        return self in (Verdict.HOLDS, Verdict.HOLDS_WITH_FEEDBACK)


class Question(Enum):
    """What is asked of a plan, in this order; the value is the question in words. `JUDGE` is asked of the replay, `SHOWN` of nobody."""

    TASK = "Is it a plan of this task?"
    GOAL = "Does it say that it reaches the goal?"
    FORCES = "Is what it claims of its forces physical?"
    MOTION = "Do its inputs give its motion, and the goal?"
    POSSIBLE = "Is the replayed motion possible?"
    SCHEME = "Does it solve its own discrete equations?"
    JUDGE = "Is the judge well?"
    SHOWN = ""

    @property
    def number(self) -> int | None:
        """1 to 6; None for the last two."""
        place = list(Question).index(self) + 1
        return place if place <= 6 else None


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric of the score.

    value: None where it was not asked or could not be measured (`reason` says why); error: how wrong the value may be by the replay's own error (0
    for what is of the plan alone); limit: with its `reason`, from the scene or the metric's default, None where the metric is not judged;
    ok: the value against the limit, None where that is undecided or there is no limit; default: whether the limit is the metric's own.
    """

    name: str
    question: Question
    value: float | None
    unit: str
    meaning: str
    error: float = 0.0
    limit: float | None = None
    reason: str = ""
    ok: bool | None = None
    default: bool = True

    @property
    def is_judged(self) -> bool:
        """Whether a question was asked by it."""
        return self.limit is not None


@dataclass(frozen=True, kw_only=True)
class Score:
    """All metrics of one plan and the verdict.

    why: the sentence that decided it, with the cause and what to do; metrics: of the plan and of the replay of its inputs alone; those of the replay
    with feedback, where there was one, are called tracked_<name>, and feedback_<..> what it took. judged: "open" or "feedback", of which replay the
    verdict speaks. waived: limits that the scene waives, with its reasons; not_asked: what was not asked, and why. questions: "yes", "no", "undecided" or "not asked" for each.
    """

    metrics: tuple[Metric, ...]
    verdict: Verdict
    why: str
    judged: str = "open"
    questions: tuple[tuple[Question, str], ...] = ()
    waived: tuple[str, ...] = ()
    not_asked: tuple[str, ...] = ()

    def metric(self, name: str) -> Metric | None:
        """The metric of that name; None if it does not apply."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def value(self, name: str) -> float | None:
        """The value of a metric; None if it was not measured."""
        metric = self.metric(name)
        return None if metric is None else metric.value

    def __repr__(self) -> str:
        return f"<Score: {self.verdict.value}: {self.why}>"
