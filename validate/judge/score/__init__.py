"""Score a plan: metrics with limits and reasons, answers to the questions, and a verdict.

    score(scene, plan, replay(scene, fmu, plan)).why
    -> "its contact forces are not those of contact: ...; driven by its inputs the motion ends 0.27
    m from the goal, ..."

The score uses the plan and its replay, not the method.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.codegen.kernel import KernelError
from models.errors import SceneError, TrajectoryError, did_you_mean
from models.scene import Scene
from models.trajectory import Hold, Trajectory
from validate.judge.replay.result import Replay
from validate.judge.replay.subject import Subject
from validate.judge.score.cause import ScoredPlan
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import MEASURES
from validate.judge.score.sentence import explain
from validate.judge.score.table import EXPLAINING, FEEDBACK, FOLLOWED, TABLE, Measured, MetricEntry
from validate.judge.score.verdict import (
    Answer,
    Contradicted,
    LeavesBounds,
    Metric,
    Question,
    Score,
    Unmeasured,
    Verdict,
    decide,
    held_to,
    wants_feedback,
)

__all__ = [
    "Metric",
    "Question",
    "Score",
    "Verdict",
    "check_limits",
    "metric_names",
    "score",
    "wants_feedback",
]

# Reasons by group of the plan that a metric needs.
_NEEDS = {
    "q": "the plan does not say its positions",
    "v": "the plan does not say its velocities",
    "lam": "the plan does not say its contact forces",
    "friction": "the plan does not say its friction forces",
    "scheme": "the plan declares no scheme",
    "no scheme": "the plan declares a scheme, whose own equations are asked instead",
}

_NAMES = tuple(entry.name for entry in (*TABLE, *FOLLOWED, *EXPLAINING))

# Metrics that are shown, not judged, and what may be limited instead.
_SHOWN = {entry.name: "" for entry in (*TABLE, *EXPLAINING) if entry.question is Question.SHOWN} | {
    "physics": "physics_scaled",
    "cost": "replay_cost, the cost of the true motion",
    "grid_error": "replay_error, which it explains",
}


def metric_names() -> tuple[str, ...]:
    """Return every metric that a scene may limit, in the order of the table."""
    return tuple(entry.name for entry in (*TABLE, *FEEDBACK))


def check_limits(scene: Subject, file: Path | None = None) -> None:
    """Raise SceneError for a limit or answer of an unknown metric; file: for messages."""
    where = f"scene {scene.name}" if file is None else f"scene file {file}: scene {scene.name}"
    for answer in scene.answers:
        if answer.measure and answer.measure not in MEASURES:
            raise SceneError(
                f"{where}: answer {answer.quantity!r} is measured by {answer.measure!r}, but the measures are {', '.join(MEASURES)}."
            )
    for name in (limit.metric for limit in scene.limits):
        there = f"{where}: there is a limit on {name}"
        if name in _SHOWN:
            part, other = name.removesuffix("error"), _SHOWN[name]
            if name.endswith("terminal_error"):
                other = f"{part}position_error and {part}velocity_error, each with its reason"
            advice = f"limit {other}." if other else "leave it out."
            raise SceneError(f"{there}, which is shown, not judged; {advice}")
        if name not in (names := metric_names()):
            hint = did_you_mean(name, names, f"the metrics are {', '.join(names)}.")
            raise SceneError(f"{where}: there is a limit on {name!r}, which is no metric; {hint}")


def score(
    scene: Subject,
    trajectory: Trajectory | None,
    replay: Replay | None,
    other_hold: Replay | None = None,
) -> Score:
    """Return all metrics and the verdict of a plan; without a replay only violations are certain.

    other_hold: replay with the other hold, if the stated hold fails. Raises TrajectoryError if
    plan, replay and scene do not match, SceneError for a limit on an unknown metric.
    """
    check_limits(scene)
    if trajectory is None:
        return Score(
            metrics=(), verdict=Verdict.NO_PLAN, why="there is no plan to judge.", names=_NAMES
        )
    trajectory.check_fits(scene)  # type: ignore[arg-type] - a foreign model answers what a scene answers
    if replay is not None:
        _check_belongs(scene, trajectory, replay)
    followed = bool(replay and replay.tracked and replay.tracked.effort)
    known = (*TABLE, *(FOLLOWED if followed else ()))
    rows = [entry for entry in known if entry.applies(scene)]
    case = Evidence(scene, trajectory, replay)
    metrics = {entry.name: _metric(entry, case) for entry in rows}
    verdict, answers, judged = decide(tuple(metrics.values()), followed)
    verdict = _of_what_is_asked(scene, trajectory, verdict, tuple(metrics.values()))
    not_asked = _not_asked(scene, rows, tuple(metrics.values()))
    if verdict in (Verdict.VIOLATES, Verdict.HOLDS_WITH_FEEDBACK):
        explaining = [entry for entry in EXPLAINING if entry.applies(scene)]
        metrics |= {entry.name: _metric(entry, case) for entry in explaining}
    waived = tuple(
        f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None
    )
    scored = ScoredPlan(
        case=case, metrics=metrics, verdict=verdict, questions=answers, waived=waived,
        holds_as=_holds_as(case, verdict, answers, other_hold),
    )  # fmt: skip
    why, cause = explain(scored)
    return Score(
        metrics=tuple(metrics.values()), verdict=verdict, why=why,
        cause=cause.code if cause else "", cause_fields=cause.fields if cause else {},
        judged=judged, waived=waived,
        questions=tuple(answers.items()), not_asked=not_asked, names=_NAMES,
    )  # fmt: skip


def _holds_as(
    case: Evidence, verdict: Verdict, answers: Mapping[Question, Answer], other_hold: Replay | None
) -> str:
    """Return another declaration with which the plan holds, or ""."""
    plan, replay, declared = case.trajectory, case.replayed, ""
    if other_hold is not None and other_hold.ok:
        hold = Hold.LINEAR if plan.hold is Hold.ZERO_ORDER else Hold.ZERO_ORDER
        declared = f"`# hold: {'linear' if hold is Hold.LINEAR else 'zero'}`"
        plan, replay = replace(plan, hold=hold), other_hold
    elif verdict is Verdict.VIOLATES and plan.scheme and answers[Question.MOTION] == "yes":
        plan, declared = replace(plan, scheme=None), "no `# scheme:`"
    holds = declared and score(case.scene, plan, replay).verdict is Verdict.HOLDS
    return declared if holds else ""


# Metrics that a plan must satisfy to hold: goal and cost.
_ASKING = ("terminal_", "replay_terminal_", "replay_cost")


def _of_what_is_asked(
    scene: Subject, plan: Trajectory, verdict: Verdict, metrics: tuple[Metric, ...]
) -> Verdict:
    """Return the verdict of a plan without goal or cost: consistent, or not applicable."""
    asked = any(metric.is_judged and metric.name.startswith(_ASKING) for metric in metrics)
    if asked or not verdict.is_good:
        return verdict
    groups = {"lam": scene.nc, "friction": scene.nf}
    forces = any(count and group not in plan.missing for group, count in groups.items())
    return Verdict.CONSISTENT if plan.has_states or forces else Verdict.NOT_APPLICABLE


def _check_belongs(scene: Subject, trajectory: Trajectory, replay: Replay) -> None:
    t, nodes = trajectory.t, replay.t[replay.knots]
    wrong = ""
    if replay.scene != scene.name:
        wrong = f"it is of scene {replay.scene}, but the plan is judged as one of {scene.name}."
    elif replay.ok and not np.array_equal(nodes, t):
        wrong = f"its {len(nodes)} nodes are not the {len(t)} of the plan; it is the replay of another plan."
    if wrong:
        raise TrajectoryError(f"replay: {wrong}")


def _why_not_asked(entry: MetricEntry, case: Evidence) -> str:
    """Return why a metric does not apply to a plan, or ""."""
    plan, counts = case.trajectory, {"friction": case.scene.nf, "lam": case.scene.nc}
    # A scheme needs forces; without them the plan is judged as one without a scheme.
    absent = {"no scheme" if plan.scheme else "scheme", *plan.missing}
    for need in entry.needs:
        if need in absent and counts.get(need, 1):
            untouched = need == "lam" and case.touches_nothing
            more = "; the replayed motion touches no contact" if untouched else ""
            return f"{_NEEDS[need]}{more}."
    return ""


def _not_asked(
    scene: Subject, rows: list[MetricEntry], metrics: tuple[Metric, ...]
) -> tuple[str, ...]:
    by_reason: dict[str, list[str]] = {}
    for entry, metric in zip(rows, metrics, strict=True):
        is_empty = metric.value is None and metric.limit is None
        is_asked = entry.question not in (Question.SHOWN, Question.JUDGE)
        if is_empty and is_asked and not metric.reason.startswith(_NEEDS["no scheme"]):
            by_reason.setdefault(metric.reason, []).append(metric.name)
    by_reason.pop("", None)
    sentences = [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]
    return (*sentences, *getattr(scene, "not_asked", ()))


def _worst(
    measured: Measured | tuple[float, float] | float, units: tuple[str, ...], limited: bool
) -> tuple[float, float, float, float, str | None]:
    """Return value, error, scale, rounding and unit of the deciding component; no unit of a norm.

    The largest value under a scene's limit, else the largest relative to its own limit.
    """
    if not isinstance(measured, Measured):
        value, error = measured if isinstance(measured, tuple) else (measured, 0.0)
        measured = Measured(values=value, error=error)
    given = measured.values, measured.error, measured.scales, measured.allowed
    parts = np.broadcast_arrays(*(np.atleast_1d(np.asarray(part, dtype=float)) for part in given))
    values, _, scales, allowed = parts
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num((values - allowed) / scales, nan=-np.inf)
    place = int(np.argmax(values if limited else relative))
    is_norm = len(values) == 1 < len(units)
    unit = None if is_norm or place >= len(units) else units[place]
    value, error, scale, allows = (float(part[place]) for part in parts)
    return value, error, scale, allows, unit


def _metric(entry: MetricEntry, case: Evidence) -> Metric:
    own = case.scene.limit(entry.limited_by)
    empty = Metric(
        name=entry.name, question=entry.question, value=None, unit=entry.unit(case.scene),
        meaning=entry.meaning, default=own is None or own.value is None,
    )  # fmt: skip
    if absent := _why_not_asked(entry, case):
        return replace(empty, reason=absent)
    waived = own is not None and own.value is None
    # A default limit is a factor of the scale, a scene's limit an absolute number.
    stated, reason = entry.default or (math.inf, "")
    if own is not None and own.value is not None:
        stated, reason = own.value, own.reason
    judged = entry.question is not Question.SHOWN and not waived and math.isfinite(stated)
    try:
        # Beyond its stability limit the plan's own step may overflow; that is rejected below.
        with np.errstate(over="ignore", invalid="ignore"):
            value, error, scale, allowed, unit = _worst(
                entry.measure(case), entry.units(case.scene), not empty.default
            )
        if not math.isfinite(value):
            raise LeavesBounds("the metric is too large to be a number.")
    except (Unmeasured, KernelError) as missing:
        unmeasured, beyond = replace(empty, reason=str(missing)), isinstance(missing, LeavesBounds)
        is_open = beyond or isinstance(missing, Contradicted) or _can_be_asked(entry, case)
        if not judged or not is_open:
            return replace(unmeasured, default=True)
        return replace(unmeasured, limit=stated, ok=False if beyond else None)
    measured = replace(empty, value=value, error=error, unit=unit or empty.unit)
    bound = (stated * scale if empty.default else stated) + allowed
    if not judged or not math.isfinite(bound):
        why = own.reason if own is not None and waived else ""
        return replace(measured, reason=why, default=True)
    return held_to(measured, bound, reason, default=empty.default)


def _can_be_asked(entry: MetricEntry, case: Evidence) -> bool:
    """Return whether an unmeasured metric leaves a question open; on external FMUs it does not."""
    if isinstance(case.scene, Scene) or not entry.of_replay:
        return isinstance(case.scene, Scene)
    return case.replayed is None or not case.replayed.ok
