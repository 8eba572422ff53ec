"""The metrics of a stage by question, of the inputs alone and with feedback; and where its motions end.

questions_of(stage)[3].metrics[0].name, .alone.value, .followed.value  ->  "replay_error", 0.6, 0.004
"""

from __future__ import annotations

from dataclasses import dataclass

from reports.records.record import FEEDBACK, TRACKED, MetricRecord, SceneRecord, StageRecord
from reports.wording import measured

_JUDGE, SHOWN = "Is the judge well?", "Shown, not judged"


@dataclass(frozen=True)
class MetricView:
    """One metric as the pages show it. alone: for the inputs alone, followed: with feedback; None where there is no such value."""

    name: str
    alone: MetricRecord | None
    followed: MetricRecord | None

    @property
    def metric(self) -> MetricRecord:
        """Of which unit, limit and meaning are told."""
        found = self.alone or self.followed
        assert found is not None  # one of them is there
        return found

    @property
    def is_judged(self) -> bool:
        """Whether either replay has a limit for it."""
        return any(metric is not None and metric.limit is not None for metric in (self.alone, self.followed))

    @property
    def waived(self) -> str:
        """The scene's reason why this is not judged; empty where it is, or where there is nothing to waive."""
        metric = self.metric
        return "" if self.is_judged or metric.value is None or metric.question is None else metric.reason


@dataclass(frozen=True)
class QuestionView:
    """One question, its answer for the replay that the verdict is of, and the metrics it was asked by."""

    number: int | None
    text: str
    answer: str
    metrics: tuple[MetricView, ...]


def questions_of(stage: StageRecord) -> list[QuestionView]:
    """The questions in order, then what was measured of the judge, and what is only shown; a metric that was not asked is in `stage.not_asked`."""
    views = _views(stage)
    found = []
    for question in stage.questions:
        mine = tuple(view for view in views if _belongs(view, question.number))
        found.append(QuestionView(question.number, question.text, question.answer, mine))
    told = {id(view) for question in found for view in question.metrics}
    rest = tuple(view for view in views if id(view) not in told and (view.metric.question is None or not stage.questions))
    return [*found, QuestionView(None, SHOWN, "", rest)] if rest else found


def _belongs(view: MetricView, number: int | None) -> bool:
    if number is None:
        return view.metric.question is None and view.is_judged
    return view.metric.question == number and (view.is_judged or view.metric.value is not None)


def _views(stage: StageRecord) -> list[MetricView]:
    names = list(dict.fromkeys(metric.name.removeprefix(TRACKED) for metric in stage.metrics))
    views = []
    for name in names:
        alone, followed = stage.metric(name), stage.metric(f"{TRACKED}{name}")
        views.append(MetricView(name, None, alone) if name.startswith(FEEDBACK) else MetricView(name, alone, followed))
    return views


def end_of(stage: StageRecord, scene: SceneRecord, *, tracked: bool | None = None) -> str:
    """Where a replay ends: `position 0.11 m, velocity 0.10 m/s`, `free end`, or empty where it was not replayed. tracked: None takes the judged one."""
    prefix = TRACKED if (stage.is_tracked if tracked is None else tracked) else ""
    found = distance_of(stage, f"{prefix}replay_")
    if found or stage.replay is None:
        return found
    return "free end" if all(goal is None for goal in scene.goal) else ""


def distance_of(stage: StageRecord, prefix: str) -> str:
    """How far from the goal a motion ends, positions and velocities apart: `position 0.11 m, velocity 0.10 m/s`; empty where it was not measured.

    prefix: of the metrics; nothing for the plan itself, `discrete_` for exact contact on its own grid, `replay_`, `tracked_replay_`.
    """
    parts = []
    for part in ("position", "velocity"):
        metric = stage.metric(f"{prefix}terminal_{part}_error")
        if metric is not None and metric.value is not None:
            parts.append(f"{part} {measured(metric.value, metric.unit)}")
    whole = stage.metric(f"{prefix}terminal_error")
    if not parts and whole is not None and whole.value is not None:
        parts.append(f"error {measured(whole.value, whole.unit)}")
    return ", ".join(parts)
