"""One section a run: its stages with questions and metrics, plan against replay, iteration history, certificate, options, seconds, log."""

from __future__ import annotations

from dataclasses import dataclass

from reports.again import again
from reports.judged import QuestionView, end_of, is_tracked, questions_of
from reports.pages.player import Film, film
from reports.pages.section import Report, Section
from reports.pages.stage_plots import StagePlots, is_empty, stage_plots
from reports.pages.starts import Spread, spread
from reports.records.record import RunRecord, SceneRecord, StageRecord
from reports.wording import tail

# So many runs are shown open; of more, a reader wants the list first.
_FEW = 12


@dataclass(frozen=True)
class StageView:
    """A stage and what is drawn of it; questions: what was asked and measured, ends: (which replay, where it ends); tracked: whether the verdict is of
    the replay with feedback, both: whether there is one; empty: it left no plan, idle: it did not even run."""

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
            questions_of(stage),
            _ends(run.scene, stage),
            is_tracked(stage),
            _is_followed(stage),
            is_empty(stage),
            is_empty(stage) and stage.seconds.stage == 0 and stage.iterations == 0,
        )
        for place, stage in enumerate(run.stages)
    ]
    return RunView(run, stages, film(run), tail(run.log_tail), again(run))


def _is_followed(stage: StageRecord) -> bool:
    return stage.replay is not None and stage.replay.tracked is not None


def _ends(scene: SceneRecord, stage: StageRecord) -> list[tuple[str, str]]:
    """Where the replays end, in words: that of the inputs alone, and that with feedback where there is one."""
    found = [("inputs alone" if _is_followed(stage) else "replay", end_of(stage, scene, tracked=False))]
    if _is_followed(stage):
        found.append(("with feedback", end_of(stage, scene, tracked=True)))
    return [(words, end) for words, end in found if end]
