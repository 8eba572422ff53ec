"""Score a plan: metrics with limits and reasons, answers to the questions, and a verdict.

    score(scene, plan, replay(scene, fmu, plan)).why
    -> "its contact forces are not those of contact: ...; driven by its inputs the motion ends 0.27
    m from the goal, ..."

The score uses the plan and its replay, not the method.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from models.codegen.kernel import KernelError
from models.errors import SceneError, TrajectoryError, did_you_mean
from models.scene import Scene
from models.trajectory import Hold, Trajectory
from validate.judge.replay.result import Replay
from validate.judge.replay.subject import Subject
from validate.judge.score.cause import ScoredPlan, cause_of, explain
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import MEASURES, halved, is_relaxed, times_the_law
from validate.judge.score.table import FEEDBACK, FOLLOWED, GROWTH, TABLE, Measured, MetricEntry
from validate.judge.score.verdict import (
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

_NAMES = tuple(entry.name for entry in (*TABLE, *GROWTH, *FOLLOWED))

# Advice for a limit on a metric that is only shown.
_INSTEAD = {
    name: f"limit {name.removesuffix('error')}position_error and {name.removesuffix('error')}velocity_error, each with its reason."
    for name in ("terminal_error", "replay_terminal_error", "discrete_terminal_error")
} | {
    "physics": "limit physics_scaled.",
    "cost": "limit replay_cost, the cost of the true motion.",
    "grid_error": "limit replay_error, which it explains.",
}


def metric_names() -> tuple[str, ...]:
    """Return every metric that a scene may limit, in the order of the table."""
    return tuple(entry.name for entry in TABLE) + tuple(
        entry.name for entry in FEEDBACK if entry.default is not None
    )


def check_limits(scene: Subject, file: Path | None = None) -> None:
    """Raise SceneError for a limit or answer of an unknown metric; file: for messages."""
    where = f"scene {scene.name}" if file is None else f"scene file {file}: scene {scene.name}"
    for answer in scene.answers:
        if answer.measure and answer.measure not in MEASURES:
            raise SceneError(
                f"{where}: answer {answer.quantity!r} is measured by {answer.measure!r}, but the measures are {', '.join(MEASURES)}."
            )
    for limit in scene.limits:
        shown = next(
            (
                entry
                for entry in TABLE
                if entry.name == limit.metric and entry.question is Question.SHOWN
            ),
            None,
        )
        if shown is not None:
            raise SceneError(
                f"{where}: there is a limit on {limit.metric}, which is shown, not judged; {_INSTEAD.get(limit.metric, 'leave it out.')}"
            )
        if limit.metric not in metric_names():
            hint = did_you_mean(
                limit.metric, metric_names(), f"the metrics are {', '.join(metric_names())}."
            )
            raise SceneError(
                f"{where}: there is a limit on {limit.metric!r}, which is no metric; {hint}"
            )


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
    effort = replay.tracked.effort if replay is not None and replay.tracked is not None else None
    growth = replay.growth if replay is not None else None
    known = (
        *TABLE,
        *(GROWTH if growth is not None else ()),
        *(FOLLOWED if effort is not None else ()),
    )
    rows = [entry for entry in known if entry.applies(scene)]
    scored, judged = _scored(scene, trajectory, replay, rows, followed=effort is not None)
    metrics = tuple(scored.metrics.values())
    verdict = _of_what_is_asked(scene, trajectory, scored.verdict, metrics)
    waived = tuple(
        f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None
    )
    held = Hold.LINEAR if trajectory.hold is Hold.ZERO_ORDER else Hold.ZERO_ORDER
    by_hold = (
        other_hold is not None
        and other_hold.ok
        and score(scene, replace(trajectory, hold=held), other_hold).verdict is Verdict.HOLDS
    )
    scored = replace(scored, verdict=verdict, waived=waived, other_hold=by_hold)
    return Score(
        metrics=metrics, verdict=verdict, why=explain(scored), cause=cause_of(scored),
        judged=judged, waived=waived,
        questions=tuple(scored.questions.items()), not_asked=_not_asked(scene, rows, metrics),
        names=_NAMES,
    )  # fmt: skip


def _scored(
    scene: Subject,
    plan: Trajectory,
    replay: Replay | None,
    rows: list[MetricEntry],
    *,
    followed: bool,
) -> tuple[ScoredPlan, Literal["open", "feedback"]]:
    case = Evidence(scene, plan, replay)
    metrics = {entry.name: _metric(entry, case) for entry in rows}
    verdict, answers, judged = decide(tuple(metrics.values()), followed)
    return ScoredPlan(
        scene=scene, trajectory=plan, replay=replay, metrics=metrics, verdict=verdict,
        questions=answers,
        halved=partial(halved, case), times_the_law=partial(times_the_law, case),
        is_relaxed=partial(is_relaxed, case),
    ), judged  # fmt: skip


# Metrics that a plan must satisfy to hold: goal and cost.
_ASKING = frozenset(
    (
        "replay_cost",
        *(
            f"{of}terminal_{part}_error"
            for of in ("", "replay_")
            for part in ("position", "velocity")
        ),
    )
)


def _of_what_is_asked(
    scene: Subject, plan: Trajectory, verdict: Verdict, metrics: tuple[Metric, ...]
) -> Verdict:
    """Return the verdict of a plan without goal or cost: consistent, or not applicable."""
    if not verdict.is_good or any(metric.is_judged for metric in metrics if metric.name in _ASKING):
        return verdict
    claims = (
        plan.has_states
        or (scene.nc > 0 and "lam" not in plan.missing)
        or (scene.nf > 0 and "friction" not in plan.missing)
    )
    return Verdict.CONSISTENT if claims else Verdict.NOT_APPLICABLE


def _check_belongs(scene: Subject, trajectory: Trajectory, replay: Replay) -> None:
    if replay.scene != scene.name:
        raise TrajectoryError(
            f"replay: it is of scene {replay.scene}, but the plan is judged as one of {scene.name}."
        )
    if replay.ok and (
        len(replay.knots) != len(trajectory.t) or not (replay.t[replay.knots] == trajectory.t).all()
    ):
        raise TrajectoryError(
            f"replay: its {len(replay.knots)} nodes are not the {len(trajectory.t)} of the plan; it is the replay of another plan."
        )


def _why_not_asked(entry: MetricEntry, case: Evidence) -> str:
    """Return why a metric does not apply to a plan, or ""."""
    plan, scene = case.trajectory, case.scene
    for need in entry.needs:
        # A scheme needs forces; without them the plan is judged as one without a scheme.
        absent = {
            "scheme": plan.scheme is None, "no scheme": plan.scheme is not None,
        }.get(need, need in plan.missing)  # fmt: skip
        if (need == "friction" and not scene.nf) or (need == "lam" and not scene.nc):
            absent = False
        if absent:
            return f"{_NEEDS[need]}{'; the replayed motion touches no contact' if need == 'lam' and case.touches_nothing else ''}."
    return ""


def _not_asked(
    scene: Subject, rows: list[MetricEntry], metrics: tuple[Metric, ...]
) -> tuple[str, ...]:
    by_reason: dict[str, list[str]] = {}
    for entry, metric in zip(rows, metrics, strict=True):
        if (
            entry.question not in (Question.SHOWN, Question.JUDGE)
            and metric.value is None
            and metric.limit is None
            and metric.reason
        ):
            by_reason.setdefault(metric.reason, []).append(metric.name)
    sentences = [
        f"{', '.join(names)}: {reason}"
        for reason, names in by_reason.items()
        if not reason.startswith(_NEEDS["no scheme"])
    ]
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
    values = np.atleast_1d(np.asarray(measured.values, dtype=float))
    parts = [
        np.broadcast_to(np.asarray(part, dtype=float), values.shape)
        for part in (measured.error, measured.scales, measured.allowed)
    ]
    _, scales, allowed = parts
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num((values - allowed) / scales, nan=-np.inf)
    place = int(np.argmax(values if limited else relative))
    error, scale, allows = (float(part[place]) for part in parts)
    is_norm = len(values) == 1 < len(units)
    return (
        float(values[place]),
        error,
        scale,
        allows,
        units[place] if place < len(units) and not is_norm else None,
    )


def _metric(entry: MetricEntry, case: Evidence) -> Metric:
    scene_limit = case.scene.limit(entry.limited_by)
    empty = Metric(
        name=entry.name,
        question=entry.question,
        value=None,
        unit=entry.unit(case.scene),
        meaning=entry.meaning,
    )
    if absent := _why_not_asked(entry, case):
        return replace(empty, reason=absent)
    waived = scene_limit is not None and scene_limit.value is None
    judged = (
        entry.question is not Question.SHOWN
        and not waived
        and (scene_limit is not None or entry.default is not None)
    )
    # A default limit is a factor of the scale, a scene's limit an absolute number.
    stated, reason = (
        (scene_limit.value, scene_limit.reason)
        if scene_limit is not None and scene_limit.value is not None
        else entry.default or (0.0, "")
    )
    try:
        # Beyond its stability limit the plan's own step may overflow; that is rejected below.
        with np.errstate(over="ignore", invalid="ignore"):
            value, error, scale, allowed, unit = _worst(
                entry.measure(case), entry.units(case.scene), scene_limit is not None and not waived
            )
        if not math.isfinite(value):
            raise LeavesBounds("the metric is too large to be a number.")
    except (Unmeasured, KernelError) as missing:
        beyond, unmeasured = isinstance(missing, LeavesBounds), replace(empty, reason=str(missing))
        if not judged or not (
            beyond or isinstance(missing, Contradicted) or _can_be_asked(entry, case)
        ):
            return unmeasured
        return replace(
            unmeasured, limit=stated, ok=False if beyond else None, default=scene_limit is None
        )
    measured = replace(empty, value=value, error=error, unit=unit or empty.unit)
    if not judged:
        return replace(
            measured, reason=scene_limit.reason if scene_limit is not None and waived else ""
        )
    bound = (stated if scene_limit is not None else stated * scale) + allowed
    if not math.isfinite(bound):
        return measured
    return held_to(measured, bound, reason, default=scene_limit is None)


def _can_be_asked(entry: MetricEntry, case: Evidence) -> bool:
    """Return whether an unmeasured metric leaves a question open; on external FMUs it does not."""
    if isinstance(case.scene, Scene):
        return True
    try:
        if entry.of_replay:
            case.replay  # noqa: B018 - a failed replay leaves everything open
    except Unmeasured:
        return True
    return False
