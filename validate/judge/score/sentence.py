"""The sentence of a verdict: its deciding metric, the cause of a failure, and what decides."""

from __future__ import annotations

import math

from models.scene import Scene
from validate.judge.score.cause import Cause, ScoredPlan, find_cause, number, rounded
from validate.judge.score.table import FEEDBACK, TABLE
from validate.judge.score.verdict import (
    EFFORT,
    MARGIN,
    SHARE,
    TRACKED,
    Metric,
    Question,
    Verdict,
    is_of_feedback,
)

_ENTRIES = {entry.name: entry for entry in (*TABLE, *FEEDBACK)}
# Most additional digits to print a value apart from its limit.
_MORE_DIGITS = 7
_ENDS = tuple(
    f"{TRACKED}{name}"
    for name in ("replay_terminal_position_error", "replay_terminal_velocity_error", "replay_error")
)


def explain(scored: ScoredPlan) -> tuple[str, Cause | None]:
    """Return the reason of the verdict in one or two sentences, and its cause if it is bad."""
    cause: Cause | None = None
    match scored.verdict:
        case Verdict.VIOLATES:
            cause = find_cause(scored, _above(scored)[0])
            text = _violates(scored, cause)
        case Verdict.UNDECIDED:
            open_ones = (*_unwell(scored), *_judged(scored, None), *_judged(scored, False))
            cause = Cause(open_ones[0].name) if open_ones else None
            text = _undecided(scored)
        case Verdict.HOLDS:
            text = _holds(scored)
        case Verdict.HOLDS_WITH_FEEDBACK:
            text = _holds_with_feedback(scored)
        case Verdict.CONSISTENT:
            shown = "" if isinstance(scored.case.scene, Scene) else f" {_of_what_is_shown(scored)}"
            text = f"consistent{shown}; {_asks_nothing(scored)}"
        case _:
            text = f"inputs alone claim nothing, and {_asks_nothing(scored)}"
    names = ", ".join(waived.partition(":")[0] for waived in scored.waived)
    return text + (f" Waived: {names}." if names else ""), cause


def _judged(scored: ScoredPlan, ok: bool | None, of_feedback: bool = False) -> list[Metric]:
    judged = [item for item in scored.metrics.values() if item.is_judged and item.ok is ok]
    metrics = [item for item in judged if is_of_feedback(item.name) is of_feedback]
    return sorted(metrics, key=lambda metric: list(Question).index(metric.question))


def _above(scored: ScoredPlan) -> list[Metric]:
    return [metric for metric in _judged(scored, False) if metric.question is not Question.JUDGE]


def _unwell(scored: ScoredPlan) -> list[Metric]:
    found = (*_judged(scored, None), *_judged(scored, False))
    return [metric for metric in found if metric.question is Question.JUDGE]


def _violates(scored: ScoredPlan, cause: Cause) -> str:
    above, replay = _above(scored), scored.case.replayed
    first = above[0]
    text, quoted = quote(first) + cause.sentence, [first.name]
    consequence = next((metric for metric in above if metric.question is Question.MOTION), None)
    if first.question in (Question.TASK, Question.FORCES) and consequence is not None:
        text += f"; {quote(consequence)}"
        quoted.append(consequence.name)
    others = [metric.name for metric in above if metric.name not in quoted]
    if others:
        text += f"; also above their limits: {', '.join(others)}"
    missed = _judged(scored, False, of_feedback=True)
    is_tracked = replay is not None and replay.tracked is not None
    if missed and is_tracked and scored.questions.get(Question.MOTION) != "yes":
        return f"{text}. With feedback too: {quote(missed[0])}."
    return f"{text}."


def _undecided(scored: ScoredPlan) -> str:
    if unwell := _unwell(scored):
        first, known = unwell[0], ""
        if first.ok is None and first.value is not None:
            known = f", known to {number(first.error, first.unit)}"
        return f"the judge is not well, so nothing is said of the plan: {quote(first)}{known}."
    unsure = _judged(scored, None)
    if not unsure:
        alone, open_with = _judged(scored, False), _judged(scored, None, of_feedback=True)
        if not alone:
            return "no question could be decided."
        why = f": {_unknown(open_with[0])}" if open_with else ""
        return f"{quote(alone[0])}; whether feedback would help could not be decided{why}."
    others = ", ".join(metric.name for metric in unsure[1:])
    text = _unknown(unsure[0]) + (f"; nor decided: {others}." if others else ".")
    replay = scored.case.replayed
    needed = "" if replay is None or unsure[0].value is None else replay.error.would_decide
    return f"{text} What would decide it: {needed}." if needed else text


def _unknown(metric: Metric) -> str:
    if metric.value is None:
        return f"{metric.name} could not be measured: {metric.reason.rstrip('.')}"
    if math.isinf(metric.error):
        return f"{quote(metric)}, but the replay has no error estimate"
    return f"{quote(metric)}, but the replay's own error of {number(metric.error, metric.unit)} is not {MARGIN:g} times below the distance between them"


def _holds(scored: ScoredPlan) -> str:
    text = "every question asked is answered yes"
    if not isinstance(scored.case.scene, Scene):
        text = f"holds {_of_what_is_shown(scored)}"
    closest = max(
        _judged(scored, True),
        key=lambda metric: (metric.value or 0.0) / metric.limit if metric.limit else 0.0,
        default=None,
    )
    return f"{text}." if closest is None else f"{text}; closest to its limit: {quote(closest)}."


def _of_what_is_shown(scored: ScoredPlan) -> str:
    pairs = scored.questions.items()
    asked = [str(of.number) for of, word in pairs if of.number and word != "not asked"]
    return f"for what this FMU shows (question{'s' if len(asked) > 1 else ''} {', '.join(asked)})"


def _asks_nothing(scored: ScoredPlan) -> str:
    """Return the sentence that there is no goal and no limit, with advice."""
    who, advice = "the map", "give it a [goal] with its limits"
    if isinstance(scored.case.scene, Scene):
        who, advice = "the scene", "give it a goal, or a limit on its cost"
    if scored.case.scene.task.has_goal:
        advice = "no limit on its goal counts for this plan; set one, with a reason"
    return f"{who} asks for nothing: {advice}."


def _holds_with_feedback(scored: ScoredPlan) -> str:
    text, failing = "not for the inputs alone", (*_judged(scored, False), *_judged(scored, None))
    first = next((metric for metric in failing if metric.question is Question.MOTION), None)
    if first is not None:
        cause = find_cause(scored, first, ("declaration", "unstable"))
        text += f": {quote(first)}{cause.sentence}"
    effort, share = scored.value(EFFORT), scored.value(SHARE)
    took = [] if effort is None else [f"{percent(effort)} of the half-range"]
    took += [] if share is None else [f"{percent(share)} of what the plan's own inputs do"]
    text += f"; with LQR feedback, RMS effort {' and '.join(took)}, it holds"
    end = next((name for name in _ENDS if scored.value(name) is not None), None)
    return text + ("." if end is None else f": {quote(scored.metrics[end])}.")


def quote(metric: Metric) -> str:
    """Return `the motion ends 0.3 m from the goal, limit 0.06 m`, or why there is no number."""
    name = metric.name.removeprefix(TRACKED)
    if metric.value is None:
        return f"{metric.name}: {metric.reason.rstrip('.')}"
    texts = [""] * 2
    for more in range(_MORE_DIGITS):  # until the two differ
        texts = [
            percent(of, 2 + more) if name in (EFFORT, SHARE) else number(of, metric.unit, 3 + more)
            for of in (metric.value, metric.limit or 0.0)
        ]
        if texts[0] != texts[1]:
            break
    phrase = _ENTRIES[name].quote(texts[0])
    if name != metric.name:
        phrase = "with feedback " + phrase.replace("driven by its inputs ", "")
    return f"{phrase}, limit {texts[1]}" if metric.is_judged else phrase


def percent(share: float, digits: int = 2) -> str:
    """Return `24 %`."""
    return f"{100 * share:.{digits}g} %" if abs(share) < 10 else f"{rounded(100 * share, digits)} %"
