"""One section a run: its stages with figures, plan against replay, iteration history, certificate, options, seconds, log."""

from __future__ import annotations

from dataclasses import dataclass

from reports.again import again
from reports.judged import is_tracked, judged_metric
from reports.pages.player import Film, film
from reports.pages.section import Report, Section
from reports.pages.stage_plots import StagePlots, is_empty, stage_plots
from reports.pages.starts import Spread, spread
from reports.record import MetricRecord, RunRecord, StageRecord
from reports.wording import tail

# So many runs are shown open; of more, a reader wants the list first.
_FEW = 12


@dataclass(frozen=True)
class StageView:
    """A stage and what is drawn of it; missed: where the judged replay ends, tracked: whether that is the one with feedback; empty: it left no
    plan, idle: it did not even run."""

    stage: StageRecord
    plots: StagePlots
    spread: Spread | None
    last: bool
    missed: MetricRecord | None
    tracked: bool
    empty: bool
    idle: bool


@dataclass(frozen=True)
class RunView:
    """A run and its stages; the film shows the last stage that has something to show."""

    run: RunRecord
    stages: list[StageView]
    film: Film | None
    log: str
    again: str


def build(report: Report) -> Section | None:
    runs = report.stored.runs
    if not runs:
        return None
    many, few = len(report.scenes) > 1, len(runs) <= _FEW
    articles = [report.article(run, opened=few) for run in runs]
    if many and not few:
        # The contents lead to the first run of each scene: hundreds of lines would be none.
        first = {run.scene.name: report.anchor(run) for run in reversed(runs)}
        entries = tuple((first[scene.name], scene.name) for scene in report.scenes)
    else:
        entries = tuple((report.anchor(run), f"{run.pipeline}, {run.scene.name}" if many else run.pipeline) for run in runs)
    return Section("runs", "Runs", "runs.html", {"articles": articles}, entries, folds=False)


def view_of(run: RunRecord) -> RunView:
    """What is told of a run, from its whole record alone: neither its number nor its rows' are in it."""
    last = len(run.stages) - 1
    stages = [
        StageView(
            stage,
            stage_plots(run.scene, stage),
            spread(stage),
            place == last,
            judged_metric(stage, "replay_terminal_error"),
            is_tracked(stage),
            is_empty(stage),
            is_empty(stage) and stage.seconds.stage == 0 and stage.iterations == 0,
        )
        for place, stage in enumerate(run.stages)
    ]
    return RunView(run, stages, film(run), tail(run.log_tail), again(run))
