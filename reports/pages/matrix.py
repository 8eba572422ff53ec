"""Scene by pipeline: verdict, cost, and the terminal error after the replay."""

from __future__ import annotations

from dataclasses import dataclass

from reports.judged import judged_metric
from reports.pages.section import Report, Section
from reports.record import RunRecord
from reports.wording import VERDICTS


@dataclass(frozen=True)
class Cell:
    """A run of a pipeline on a scene, as the matrix shows it; `missed` is the terminal error after the replay."""

    run: RunRecord
    anchor: str
    cost: float | None
    missed: float | None
    unit: str


@dataclass(frozen=True)
class Holding:
    """On how many scenes a pipeline's plan holds, of those it was run on."""

    holds: int
    run: int


def build(report: Report) -> Section | None:
    runs = report.stored.runs
    if not runs:
        return None
    cells = {(run.pipeline, run.scene.name): _cell(report, run) for run in runs}
    titles = {run.pipeline: run.pipeline_title for run in runs}
    holding = {
        name: Holding(sum(run.verdict == "holds" for run in mine), len(mine))
        for name in titles
        if (mine := [cell.run for (pipeline, _), cell in cells.items() if pipeline == name])
    }
    return Section(
        "matrix",
        "Scenes and pipelines",
        "matrix.html",
        {"scenes": report.scenes, "titles": titles, "cells": cells, "holding": holding, "verdicts": VERDICTS},
        folds=False,
    )


def _cell(report: Report, run: RunRecord) -> Cell:
    last = run.stages[-1] if run.stages else None
    missed = judged_metric(last, "replay_terminal_error") if last else None
    return Cell(run, report.anchor(run), last.cost if last else None, missed.value if missed else None, missed.unit if missed else "")
