"""From metrics and limits to the answers of the questions, and from those to a verdict.

A metric is below its limit, or above it, only where ten times its error does not reach from its
value to the limit,

    value + 10 error <= limit   -> yes   value - 10 error > limit   -> no   otherwise undecided

so that a metric of 1e-9 with an error of 1e-4 is rightly below a limit of 1e-2, and one of 0.0599
with the same error is not judged against 0.06. The error is that of the replay; metrics of the plan
alone have none, and what is asked of the judge itself is measured with its error once, since that
is what is asked about. A question is answered no where one of its metrics surely is, else undecided
where one is, else yes. Where the judge is not well nothing that the replay says is sure: questions
4 and 5 are undecided.

The verdict of all: no plan | violates, if an asked question surely fails, even behind an undecided
one | undecided | holds. Where question 4 fails or is undecided, limited feedback may help:
questions 4 and 5 are then asked of the replay with feedback, with the same limits.

What the judge says: metrics, the answers to its questions, and a verdict with the sentence that
decided it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal, TypeAlias

from models.errors import UnknownNameError, did_you_mean


class Unmeasured(Exception):  # noqa: N818 - a metric that cannot be measured is a value with a reason
    """Raised within the measurement of a metric; the text is the reason."""


class LeavesBounds(Unmeasured):
    """The motion leaves every bound: there is no number, but the question is answered."""


class Contradicted(Unmeasured):
    """What somebody's FMU shows contradicts its map: the question stays open, for scenes and FMUs alike."""


class Verdict(Enum):
    """What is said of a plan; the value is the word that every table, file and sentence uses.

    `holds`: every question that was asked is answered yes for the inputs alone; `holds with
        feedback`: not so, but with limited feedback around the
    plan; `violates`: one surely is not; `undecided`: none surely is not, but one could not be
        decided; `no plan`: there is nothing to judge;
    `not applicable`: the method does not apply, or nothing is claimed and nothing asked;
        `consistent`: nothing is wrong, and the scene asks for nothing.
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
    """What is asked of a plan, in this order; the value is the question in words.

    `JUDGE` is asked of the replay, `SHOWN` of nobody.
    """

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
        """1 to 6; None for the last two."""
        place = list(Question).index(self) + 1
        return place if place <= 6 else None


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric of the score.

    value: None where it was not asked or could not be measured (`reason` says why); error: how
        wrong the value may be by the replay's own error (0
    for what is of the plan alone); limit: with its `reason`, from the scene or the metric's
        default, None where the metric is not judged;
    ok: the value against the limit, None where that is undecided or there is no limit; default:
        whether the limit is the metric's own.
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

    def held_to(self, limit: float, reason: str, *, default: bool) -> Metric:
        """The same, judged by a limit; of what is asked of the judge itself the error counts once.

        Raises TypeError where there is no value.
        """
        margin = 1.0 if self.question is Question.JUDGE else MARGIN
        return replace(
            self,
            limit=limit,
            reason=reason,
            ok=compare(self.value, self.error, limit, margin),  # type: ignore[arg-type]
            default=default,
        )


Answer: TypeAlias = Literal["yes", "no", "undecided", "not asked"]


@dataclass(frozen=True, kw_only=True)
class Score:
    """All metrics of one plan and the verdict.

    why: the sentence that decided it, with the cause and what to do; cause: the same in one word,
        empty where nothing is wrong: the name of the metric that
    failed or is open, or where the inputs do not give the motion one of `defect`, `relaxed
        contact`, `unstable`, `coarse grid`, `motion`; metrics: of the plan and of the replay of its
        inputs alone; those of the replay
    with feedback, where there was one, are called tracked_<name>, and feedback_<..> what it took.
        judged: "open" or "feedback", of which replay the
    verdict speaks. waived: limits that the scene waives, with its reasons; not_asked: what was not
        asked, and why. questions: "yes", "no", "undecided" or "not asked" for each.
    names: of all metrics there are, whether or not they apply; empty where whoever judged does not
        say.
    """

    metrics: tuple[Metric, ...]
    verdict: Verdict
    why: str
    cause: str = ""
    judged: Literal["open", "feedback"] = "open"
    questions: tuple[tuple[Question, Answer], ...] = ()
    waived: tuple[str, ...] = ()
    not_asked: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def metric(self, name: str) -> Metric | None:
        """The metric of that name; None if it does not apply."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def value(self, name: str) -> float | None:
        """The value of a metric; None if it was not measured.

        Raises UnknownNameError for a name that no metric has.
        """
        metric = self.metric(name)
        if metric is None and self.names and name not in self.names:
            hint = did_you_mean(name, self.names, f"there are {', '.join(self.names)}.")
            raise UnknownNameError(f"there is no metric {name!r}; {hint}")
        return None if metric is None else metric.value

    def __repr__(self) -> str:
        return f"<Score: {self.sentence}>"

    @property
    def sentence(self) -> str:
        """The verdict and why, in a sentence that begins with its word."""
        return (
            self.why
            if self.why.startswith(self.verdict.value)
            else f"{self.verdict.value}: {self.why}"
        )


MARGIN = 10.0
# What feedback may take of the inputs, see validate.judge.score.table.
EFFORT = "feedback_effort"
SHARE = "feedback_share"
# Metrics of the replay with feedback are called so.
TRACKED = "tracked_"
# Of the replay, and so only as sure as the judge is well.
_OF_REPLAY = (Question.MOTION, Question.POSSIBLE)
# Of the plan alone, which feedback cannot mend.
_NOT_MENDED = (Question.TASK, Question.GOAL, Question.FORCES, Question.SCHEME)


def compare(value: float, error: float, limit: float, margin: float = MARGIN) -> bool | None:
    """Whether a value is below its limit; None where its error leaves that open.

    See the module docstring.
    """
    if value + margin * error <= limit:
        return True
    if value - margin * error > limit:
        return False
    return None


def answer(metrics: Iterable[Metric]) -> Answer:
    """Of the judged metrics of one question."""
    judged = [metric.ok for metric in metrics if metric.is_judged]
    if not judged:
        return "not asked"
    return "no" if False in judged else "undecided" if None in judged else "yes"


def answers(metrics: Sequence[Metric], *, with_feedback: bool = False) -> dict[Question, Answer]:
    """Of every question, by metrics of the plan and of the replay of its inputs alone.

    with_feedback: questions 4 and 5 are asked of the replay with feedback instead; what it took
        belongs to question 4.
    """
    followed = [metric for metric in metrics if with_feedback and is_of_feedback(metric.name)]
    replaced = {metric.name.removeprefix(TRACKED) for metric in followed}
    asked = [
        *followed,
        *(
            metric
            for metric in metrics
            if not is_of_feedback(metric.name) and metric.name not in replaced
        ),
    ]
    found: dict[Question, Answer] = {
        question: answer(metric for metric in asked if metric.question is question)
        for question in Question
        if question.value
    }
    if found[Question.JUDGE] in ("no", "undecided"):
        for question in _OF_REPLAY:
            if found[question] != "not asked":
                found[question] = "undecided"
    return found


def is_of_feedback(name: str) -> bool:
    """Whether a metric is of the replay with feedback, or of the feedback."""
    return name.startswith(TRACKED) or name.startswith("feedback_")


def wants_feedback(metrics: Sequence[Metric]) -> bool:
    """Return whether question 4 fails or is undecided and nothing that feedback cannot change surely fails."""
    found = answers(metrics)
    return found[Question.MOTION] in ("no", "undecided") and "no" not in [
        found[question] for question in _NOT_MENDED
    ]


def verdict_of(found: dict[Question, Answer]) -> Verdict:
    """Of one set of answers."""
    asked = [word for question, word in found.items() if question is not Question.JUDGE]
    if "no" in asked:
        return Verdict.VIOLATES
    if "undecided" in asked or found[Question.JUDGE] in ("no", "undecided"):
        return Verdict.UNDECIDED
    return Verdict.HOLDS


def verdict_with_feedback(alone: Verdict, followed: dict[Question, Answer]) -> Verdict:
    """Of the answers for the inputs alone and with feedback.

    An inputs-alone failure that is sure, and feedback that is not, leave it undecided.
    """
    with_feedback = verdict_of(followed)
    if with_feedback is Verdict.HOLDS:
        return Verdict.HOLDS_WITH_FEEDBACK
    # Where they differ, one of the two is undecided: what fails for the inputs alone may hold with
    # feedback, or the other way round.
    return alone if with_feedback is alone else Verdict.UNDECIDED


def decide(
    metrics: Sequence[Metric], has_feedback: bool
) -> tuple[Verdict, dict[Question, Answer], Literal["open", "feedback"]]:
    """The verdict, the answers that it stands on, and of which replay they are: with feedback where that was tried, is wanted and helps."""
    alone = answers(metrics)
    verdict = verdict_of(alone)
    if has_feedback and wants_feedback(metrics):
        followed = answers(metrics, with_feedback=True)
        verdict = verdict_with_feedback(verdict, followed)
        if verdict is Verdict.HOLDS_WITH_FEEDBACK:
            return verdict, followed, "feedback"
    return verdict, alone, "open"
