"""The page of one run: the verdict with what decided it, then motion, stages with questions and metrics, plots, where it comes from and how to repeat it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.again import again
from reports.causes import cause_of, deciding
from reports.findings import integral_cost, last_cost
from reports.judged import FEEDBACK, TRACKED, QuestionView, end_of, is_tracked, judged_metric, questions_of
from reports.pages.player import Film, film
from reports.pages.section import Report, Section
from reports.pages.stage_plots import StagePlots, is_empty, stage_plots
from reports.pages.starts import Spread, spread
from reports.records.record import HOLD, MetricRecord, QuestionRecord, RunRecord, SceneRecord, StageRecord
from reports.traces import Motion
from reports.wording import capital, small, tail


@dataclass(frozen=True)
class StageView:
    """A stage and what is drawn of it.

    questions: what was asked and measured, of the last stage; ends: (which replay, where it ends); tracked: whether the verdict is of the replay with feedback; both:
    whether there is one; empty: it left no plan; idle: no method of ours ran.
    """

    stage: StageRecord
    plots: StagePlots
    spread: Spread | None
    last: bool
    questions: list[QuestionView]
    ends: list[tuple[str, str]]
    tracked: bool
    both: bool
    empty: bool
    idle: bool


@dataclass(frozen=True)
class Decision:
    """Why a run has its verdict. question, metric: that decided it, or came nearest to its limit; cause, advice: empty where there is nothing to mend.

    cost, integral: of the last plan, as a sum over its steps and times the time step; ends: where its replay ends, in words.
    """

    question: QuestionRecord | None
    metric: MetricRecord | None
    cause: str
    advice: str
    cost: float | None
    integral: float | None
    ends: str


@dataclass(frozen=True)
class MetricRow:
    """A judged metric over the stages of a run; found: of each stage that of the replay which is judged, None where it was not measured."""

    metric: MetricRecord
    found: list[MetricRecord | None]


@dataclass(frozen=True)
class RunView:
    """A run and its stages; the film shows the last stage that has something to show."""

    run: RunRecord
    decision: Decision
    stages: list[StageView]
    beside: list[MetricRow]
    film: Film | None
    log: str
    again: str


def build(report: Report, run: RunRecord) -> Section:
    """The section of a page that has this run alone."""
    entries = tuple((f"run-stage-{place}", _stage_words(stage)) for place, stage in enumerate(run.stages, 1))
    return Section("one", "Verdict, motion and stages", "run.html", {"view": view_of(report, run), "anchor": "run"}, entries)


def view_of(report: Report, run: RunRecord) -> RunView:
    """What is told of a run, from its record and the motions beside it alone."""
    motions = [report.motion(run, stage) for stage in run.stages]
    last = len(run.stages) - 1
    stages = [
        _stage(run.scene, stage, motion, last=place == last) for place, (stage, motion) in enumerate(zip(run.stages, motions, strict=True))
    ]
    return RunView(run, decision_of(run), stages, _beside(run.stages), film(run, motions), tail(run.log_tail), again(run))


def decision_of(run: RunRecord) -> Decision:
    """What decided the verdict of a run, from its record alone."""
    last, cause = run.stages[-1] if run.stages else None, cause_of(run)
    metric = deciding(last) if last is not None else None
    number = metric.question if metric is not None else None
    question = next((item for item in last.questions if item.number == number), None) if last is not None and metric is not None else None
    why = (last.why if last is not None else "") or (run.message if run.verdict not in HOLD else "")
    return Decision(
        question,
        metric,
        " ".join(dict.fromkeys(part for part in ("" if cause is None else f"{cause.sentence}.", capital(why)) if part)),
        "" if cause is None else cause.advice,
        last_cost(run),
        integral_cost(run.scene, last_cost(run)),
        end_of(last, run.scene) if last is not None else "",
    )


def _stage(scene: SceneRecord, stage: StageRecord, motion: Motion, *, last: bool) -> StageView:
    return StageView(
        stage,
        stage_plots(scene, stage, motion, whole=last),
        spread(stage),
        last,
        questions_of(stage) if last else [],
        _ends(scene, stage),
        is_tracked(stage),
        _is_followed(stage),
        is_empty(stage),
        stage.kind == "given" or (is_empty(stage) and stage.seconds.stage == 0 and stage.iterations == 0),
    )


def _beside(stages: Sequence[StageRecord]) -> list[MetricRow]:
    """The judged metrics of all stages, by questions; empty where there is one stage alone."""
    rows: dict[str, list[MetricRecord | None]] = {}
    for metric in (metric for stage in stages for metric in stage.metrics if len(stages) > 1):
        if metric.limit is not None and not metric.name.startswith((TRACKED, FEEDBACK)) and metric.name not in rows:
            rows[metric.name] = [judged_metric(stage, metric.name) for stage in stages]
    found = [MetricRow(next(filter(None, reversed(same))), same) for same in rows.values() if any(same)]
    return sorted(found, key=lambda row: row.metric.question or 7)


def _stage_words(stage: StageRecord) -> str:
    return stage.method + (f", ε = {small(stage.eps)}" if stage.eps else "")


def _is_followed(stage: StageRecord) -> bool:
    return stage.replay is not None and stage.replay.tracked is not None


def _ends(scene: SceneRecord, stage: StageRecord) -> list[tuple[str, str]]:
    """Where the replays end, in words: that of the inputs alone, and that with feedback where there is one."""
    found = [("inputs alone" if _is_followed(stage) else "replay", end_of(stage, scene, tracked=False))]
    if _is_followed(stage):
        found.append(("with feedback", end_of(stage, scene, tracked=True)))
    return [(words, end) for words, end in found if end]
