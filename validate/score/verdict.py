"""From metrics and limits to the answers of the questions, and from those to a verdict.

A metric is below its limit, or above it, only where ten times its error does not reach from its value to the limit,

    value + 10 error <= limit   -> yes          value - 10 error > limit   -> no          otherwise undecided

so that a metric of 1e-9 with an error of 1e-4 is rightly below a limit of 1e-2, and one of 0.0599 with the same error is not judged against 0.06.
The error is that of the replay; metrics of the plan alone have none, and what is asked of the judge itself is measured with its error once, since that
is what is asked about. A question is answered no where one of its metrics surely is, else undecided
where one is, else yes. Where the judge is not well nothing that the replay says is sure: questions 4 and 5 are undecided.

The verdict of all: no plan | violates, if an asked question surely fails, even behind an undecided one | undecided | holds. Where question 4 fails or is
undecided and the plan's own motion is consistent (unexplained_force of a plan without a scheme, defect of one with), limited feedback may help:
questions 4 and 5 are then asked of the replay with feedback, with the same limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from validate.score.result import Metric, Question, Verdict

MARGIN = 10.0
# What feedback may take of the inputs, see validate.score.feedback.
EFFORT, SHARE = "feedback_effort", "feedback_share"
# Metrics of the replay with feedback are called so.
TRACKED = "tracked_"
YES, NO, UNDECIDED, NOT_ASKED = "yes", "no", "undecided", "not asked"
# Of the replay, and so only as sure as the judge is well.
_OF_REPLAY = (Question.MOTION, Question.POSSIBLE)
# Whether a plan's own motion is consistent, so that it can be followed: the one that was asked.
_CONSISTENCY = ("unexplained_force", "defect")


def compare(value: float, error: float, limit: float, margin: float = MARGIN) -> bool | None:
    """Whether a value is below its limit; None where its error leaves that open. See the module docstring."""
    if value + margin * error <= limit:
        return True
    if value - margin * error > limit:
        return False
    return None


def answer(metrics: Iterable[Metric]) -> str:
    """Of the judged metrics of one question."""
    judged = [metric.ok for metric in metrics if metric.is_judged]
    if not judged:
        return NOT_ASKED
    return NO if False in judged else UNDECIDED if None in judged else YES


def answers(metrics: Sequence[Metric]) -> dict[Question, str]:
    """Of every question, by metrics of the plan and of the replay of its inputs alone; what feedback did is left out."""
    own = [metric for metric in metrics if not is_of_feedback(metric.name)]
    return _by_question(own)


def answers_with_feedback(metrics: Sequence[Metric]) -> dict[Question, str]:
    """The same with questions 4 and 5 asked of the replay with feedback; what it took belongs to question 4."""
    own = [metric for metric in metrics if not is_of_feedback(metric.name)]
    replaced = {metric.name.removeprefix(TRACKED) for metric in metrics if metric.name.startswith(TRACKED)}
    followed = [metric for metric in own if metric.name not in replaced] + [metric for metric in metrics if is_of_feedback(metric.name)]
    return _by_question(followed)


def _by_question(metrics: Sequence[Metric]) -> dict[Question, str]:
    found = {question: answer(metric for metric in metrics if metric.question is question) for question in Question if question.value}
    if found[Question.JUDGE] in (NO, UNDECIDED):
        for question in _OF_REPLAY:
            if found[question] != NOT_ASKED:
                found[question] = UNDECIDED
    return found


def is_of_feedback(name: str) -> bool:
    """Whether a metric is of the replay with feedback, or of the feedback."""
    return name.startswith(TRACKED) or name.startswith("feedback_")


def wants_feedback(metrics: Sequence[Metric]) -> bool:
    """Whether feedback is to be tried: question 4 is not answered yes by the inputs alone, the plan's own motion is consistent, and nothing else that
    feedback cannot mend surely fails."""
    found = answers(metrics)
    if found[Question.MOTION] not in (NO, UNDECIDED) or NO in (
        found[Question.TASK],
        found[Question.GOAL],
        found[Question.FORCES],
        found[Question.SCHEME],
    ):
        return False
    consistency = [metric.ok for metric in metrics if metric.name in _CONSISTENCY and metric.is_judged]
    return bool(consistency) and all(ok is True for ok in consistency)


def verdict_of(found: dict[Question, str]) -> Verdict:
    """Of one set of answers."""
    asked = [word for question, word in found.items() if question is not Question.JUDGE]
    if NO in asked:
        return Verdict.VIOLATES
    if UNDECIDED in asked or found[Question.JUDGE] in (NO, UNDECIDED):
        return Verdict.UNDECIDED
    return Verdict.HOLDS


def verdict_with_feedback(alone: Verdict, followed: dict[Question, str]) -> Verdict:
    """Of the answers for the inputs alone and with feedback. An inputs-alone failure that is sure, and feedback that is not, leave it undecided."""
    with_feedback = verdict_of(followed)
    if with_feedback is Verdict.HOLDS:
        return Verdict.HOLDS_WITH_FEEDBACK
    if with_feedback is alone:
        return alone
    # One of the two is undecided: what fails for the inputs alone may hold with feedback, or the other way round.
    return Verdict.UNDECIDED
