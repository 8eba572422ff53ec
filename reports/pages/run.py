"""Page of one run: verdict, motion, stages, metrics, plots and provenance; and a table of all runs.

In a single file the table includes the pages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from models.results.run import RunRecord, SceneRecord, StageRecord
from models.results.verdict import FEEDBACK, HOLD, TRACKED, Answer, Metric, Question
from reports.judged import QuestionView, again, cause_of, deciding, end_of, questions_of
from reports.pages.player import Film, film
from reports.pages.section import Report, Section
from reports.pages.stage_plots import StagePlots, stage_plots
from reports.traces import Motion
from reports.wording import capital, count, small, tail


class StageView(NamedTuple):
    """A stage and its plots.

    questions: of the last stage; ends: (replay, its end in words); idle: no method of ours ran.
    """

    stage: StageRecord
    plots: StagePlots
    questions: list[QuestionView]
    ends: list[tuple[str, str]]
    idle: bool


class Decision(NamedTuple):
    """Why a run has its verdict: deciding question and metric, cause, advice and end."""

    question: tuple[Question, Answer] | None
    metric: Metric | None
    cause: str
    advice: str
    ends: str


class RunView(NamedTuple):
    """A run and its stages; the film shows the last stage with motion; beside: see `_beside`."""

    run: RunRecord
    decision: Decision
    stages: list[StageView]
    beside: list[tuple[Metric, list[Metric | None]]]
    film: Film | None
    log: str
    again: str


def build(report: Report, run: RunRecord) -> Section:
    """Return the section of a page of this run."""
    named = [
        stage.method + (f", ε = {small(stage.eps)}" if stage.eps else "") for stage in run.stages
    ]
    entries = tuple((f"run-stage-{place}", name) for place, name in enumerate(named, 1))
    return Section(
        "one",
        "Verdict, motion and stages",
        "run.html",
        {"view": view_of(report, run), "anchor": "run"},
        entries,
    )


def view_of(report: Report, run: RunRecord) -> RunView:
    """Return the view of a run, from its record and motions."""
    motions = [report.motion(run, stage) for stage in run.stages]
    stages = [
        _stage(run.scene, stage, motion, last=stage is run.last)
        for stage, motion in zip(run.stages, motions, strict=True)
    ]
    return RunView(
        run,
        decision_of(run),
        stages,
        _beside(run.stages),
        film(run, motions),
        tail(run.log_tail),
        again(run),
    )


def decision_of(run: RunRecord) -> Decision:
    """Return what decided the verdict of a run, from its record."""
    last, cause = run.last, cause_of(run)
    metric = deciding(last) if last is not None else None
    question = (
        next((item for item in last.questions if item[0] is metric.question), None)
        if last is not None and metric is not None
        else None
    )
    why = (
        not_applicable(run)
        or (last.why if last is not None else "")
        or (run.message if run.verdict not in HOLD else "")
    )
    sentences = dict.fromkeys(
        filter(None, ("" if cause is None else f"{cause.sentence}.", capital(why)))
    )
    ends = end_of(last, run.scene) if last is not None else ""
    return Decision(
        question, metric, " ".join(sentences), "" if cause is None else cause.advice, ends
    )


def not_applicable(run: RunRecord) -> str:
    """Return why a run does not apply, without its method's name, or ""."""
    if run.verdict != "not applicable":
        return ""
    head, colon, reason = run.message.partition(": ")
    reason_text = (reason if colon and " " not in head else run.message).partition("; ")[0]
    return capital(reason_text.replace(f"scene {run.scene.name} ", "the scene ", 1))


def _stage(scene: SceneRecord, stage: StageRecord, motion: Motion, *, last: bool) -> StageView:
    plots, questions = (
        stage_plots(scene, stage, motion, whole=last),
        questions_of(stage) if last else [],
    )
    idle = stage.kind == "given" or (
        stage.is_empty and stage.seconds.wall == 0 and stage.iterations == 0
    )
    return StageView(stage, plots, questions, _ends(scene, stage), idle)


def _beside(stages: Sequence[StageRecord]) -> list[tuple[Metric, list[Metric | None]]]:
    """Return judged metrics of all stages by question, empty for a single stage."""
    rows: dict[str, list[Metric | None]] = {}
    for metric in (metric for stage in stages for metric in stage.metrics if len(stages) > 1):
        if (
            metric.limit is not None
            and not metric.name.startswith((TRACKED, FEEDBACK))
            and metric.name not in rows
        ):
            rows[metric.name] = [stage.judged(metric.name) for stage in stages]
    pairs = [(next(filter(None, reversed(same))), same) for same in rows.values() if any(same)]
    return sorted(pairs, key=lambda row: row[0].question.number or 7)


def _ends(scene: SceneRecord, stage: StageRecord) -> list[tuple[str, str]]:
    named_ends = [
        ("inputs alone" if stage.is_followed else "replay", end_of(stage, scene, tracked=False))
    ]
    if stage.is_followed:
        named_ends.append(("with feedback", end_of(stage, scene, tracked=True)))
    return [(words, end) for words, end in named_ends if end]


class Listed(NamedTuple):
    """A run as a row.

    errors: of the judged replay's final position and velocity, and from the plan; anchor, view: of
    a single file.
    """

    run: RunRecord
    link: str
    errors: list[Metric | None]
    why: str
    anchor: str
    view: RunView | None
    has_page: bool


def all_runs(report: Report) -> Section | None:
    """Return the section, None without runs."""
    runs = report.stored.runs
    if not runs:
        return None
    listed = [_listed(report, run) for run in runs]
    holding = sum(run.verdict in HOLD for run in runs)
    sentence = f"{count(len(runs), 'run')} in one table, {holding} of which {'holds' if holding == 1 else 'hold'}: verdict, cost, errors, seconds and why."
    # In a single file contents link the first run of each scene only.
    first = {run.scene.name: report.anchor(run) for run in reversed(runs)} if report.single else {}
    entries = tuple((first[scene.name], scene.name) for scene in report.scenes if first)
    return Section("runs", "All runs", "run.html", {"listed": listed}, entries, sentence)


def _listed(report: Report, run: RunRecord) -> Listed:
    names = ("terminal_position_error", "terminal_velocity_error", "error")
    errors = [run.last.judged(f"replay_{name}") if run.last else None for name in names]
    cause = cause_of(run)
    why = cause.sentence if cause is not None else not_applicable(run)
    return Listed(
        run,
        report.link(run),
        errors,
        why,
        report.anchor(run),
        view_of(report, run) if report.single else None,
        report.single or run.key in report.pages,
    )
