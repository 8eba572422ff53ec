"""From metrics and limits to answers of the questions, and to a verdict.

    value + 10 error <= limit   -> yes   value - 10 error > limit   -> no   otherwise undecided

The error is the replay's; it counts once for metrics of the judge. A question is answered no if a
metric fails, else undecided if one is, else yes. If the judge is not well, questions 4 and 5 are
undecided. The verdict: no plan | violates, if a question fails | undecided | holds. If question 4
is not answered yes, questions 4 and 5 may be answered by the replay with limited feedback.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from models.errors import UnknownNameError, did_you_mean
from models.results.verdict import TRACKED, Answer, Metric, Question, Verdict


class Unmeasured(Exception):  # noqa: N818 - a value with a reason, no error
    """A metric cannot be measured; the text is the reason."""


class LeavesBounds(Unmeasured):
    """The motion diverges: no number, but a certain answer."""


class Contradicted(Unmeasured):
    """An external FMU contradicts its map, which leaves the question open."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """All metrics of one plan, and the verdict.

    - why: deciding sentence with cause and advice.
    - cause: a code of validate.judge.score.cause.CAUSES, else the failing or undecided metric, ""
      if nothing is wrong; cause_fields: the fields of its sentence.
    - metrics: tracked_<name> and feedback_<..> are those with feedback.
    - judged: replay of the verdict, "open" or "feedback".
    - waived, not_asked: with reasons.
    - names: all metrics, even if they do not apply; may be empty.
    """

    metrics: tuple[Metric, ...]
    verdict: Verdict
    why: str
    cause: str = ""
    cause_fields: Mapping[str, str] = field(default_factory=dict)
    judged: Literal["open", "feedback"] = "open"
    questions: tuple[tuple[Question, Answer], ...] = ()
    waived: tuple[str, ...] = ()
    not_asked: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def metric(self, name: str) -> Metric | None:
        """Return the metric, None if it does not apply."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def value(self, name: str) -> float | None:
        """Return a metric's value, None if not measured. Raises UnknownNameError."""
        metric = self.metric(name)
        if metric is None and self.names and name not in self.names:
            hint = did_you_mean(name, self.names, f"there are {', '.join(self.names)}.")
            raise UnknownNameError(f"there is no metric {name!r}; {hint}")
        return None if metric is None else metric.value

    def __repr__(self) -> str:
        return f"<Score: {self.sentence}>"

    @property
    def sentence(self) -> str:
        """Return verdict and reason in one sentence."""
        word = self.verdict.value
        return self.why if self.why.startswith(word) else f"{word}: {self.why}"


MARGIN = 10.0
EFFORT = "feedback_effort"
SHARE = "feedback_share"
# Questions about the replay, which need a judge that is well.
_OF_REPLAY = (Question.MOTION, Question.POSSIBLE)
# Questions about the plan, which feedback cannot change.
_NOT_MENDED = (Question.TASK, Question.GOAL, Question.FORCES, Question.SCHEME)


def held_to(metric: Metric, limit: float, reason: str, *, default: bool) -> Metric:
    """Return the metric judged by a limit. Raises TypeError without a value."""
    margin = 1.0 if metric.question is Question.JUDGE else MARGIN
    ok = compare(metric.value, metric.error, limit, margin)  # type: ignore[arg-type]
    return replace(metric, limit=limit, reason=reason, ok=ok, default=default)


def compare(value: float, error: float, limit: float, margin: float = MARGIN) -> bool | None:
    """Return whether a value is below its limit, None if its error leaves that open."""
    above, below = value - margin * error > limit, value + margin * error <= limit
    return True if below else False if above else None


def answer(metrics: Iterable[Metric]) -> Answer:
    """Return the answer of one question's metrics."""
    judged = [metric.ok for metric in metrics if metric.is_judged]
    if not judged:
        return "not asked"
    return "no" if False in judged else "undecided" if None in judged else "yes"


def answers(metrics: Sequence[Metric], *, with_feedback: bool = False) -> dict[Question, Answer]:
    """Return the answers to all questions; with_feedback: 4 and 5 by the tracked replay."""
    followed = [metric for metric in metrics if with_feedback and is_of_feedback(metric.name)]
    replaced = {metric.name.removeprefix(TRACKED) for metric in followed}
    alone = [metric for metric in metrics if not is_of_feedback(metric.name)]
    used = [*followed, *(metric for metric in alone if metric.name not in replaced)]
    asked = [question for question in Question if question is not Question.SHOWN]
    result: dict[Question, Answer] = {}
    for question in asked:
        result[question] = answer(metric for metric in used if metric.question is question)
    if result[Question.JUDGE] in ("no", "undecided"):
        result |= {of: "undecided" for of in _OF_REPLAY if result[of] != "not asked"}
    return result


def is_of_feedback(name: str) -> bool:
    """Return whether a metric is of the replay with feedback, or of the feedback."""
    return name.startswith(TRACKED) or name.startswith("feedback_")


def wants_feedback(metrics: Sequence[Metric]) -> bool:
    """Return whether question 4 is not answered yes, and no question fails despite feedback."""
    result = answers(metrics)
    fails = "no" in [result[question] for question in _NOT_MENDED]
    return result[Question.MOTION] in ("no", "undecided") and not fails


def verdict_of(found: dict[Question, Answer]) -> Verdict:
    """Return the verdict of a set of answers."""
    words = [word for question, word in found.items() if question is not Question.JUDGE]
    if "no" in words:
        return Verdict.VIOLATES
    if "undecided" in words or found[Question.JUDGE] in ("no", "undecided"):
        return Verdict.UNDECIDED
    return Verdict.HOLDS


def verdict_with_feedback(alone: Verdict, followed: dict[Question, Answer]) -> Verdict:
    """Return the verdict of the answers without and with feedback.

    A certain failure without and an undecided one with feedback is undecided.
    """
    with_feedback = verdict_of(followed)
    if with_feedback is Verdict.HOLDS:
        return Verdict.HOLDS_WITH_FEEDBACK
    # One of two different verdicts is undecided: feedback may change the outcome.
    return alone if with_feedback is alone else Verdict.UNDECIDED


def decide(
    metrics: Sequence[Metric], has_feedback: bool
) -> tuple[Verdict, dict[Question, Answer], Literal["open", "feedback"]]:
    """Return the verdict, its answers, and its replay (with feedback if needed and helpful)."""
    alone = answers(metrics)
    verdict = verdict_of(alone)
    if has_feedback and wants_feedback(metrics):
        followed = answers(metrics, with_feedback=True)
        verdict = verdict_with_feedback(verdict, followed)
        if verdict is Verdict.HOLDS_WITH_FEEDBACK:
            return verdict, followed, "feedback"
    return verdict, alone, "open"
