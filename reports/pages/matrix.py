"""Scene by pipeline: verdict, cost, and where the replay ends."""

from __future__ import annotations

from dataclasses import dataclass

from reports.judged import end_of
from reports.pages.section import Report, Section
from reports.records.record import HOLD, RunRecord
from reports.wording import VERDICTS


@dataclass(frozen=True)
class Cell:
    """A run of a pipeline on a scene, as the matrix shows it; end: where the judged replay ends, in words."""

    run: RunRecord
    link: str
    cost: float | None
    end: list[str]


@dataclass(frozen=True)
class Holding:
    """On how many scenes a pipeline's plan holds, of those that it could hold on; with_feedback: of these not by its inputs alone."""

    holds: int
    run: int
    with_feedback: int


def build(report: Report) -> Section | None:
    """The section, or None where no run is stored."""
    runs = report.stored.runs
    if not runs:
        return None
    cells = {(run.pipeline, run.scene.name): _cell(report, run) for run in runs}
    titles = {run.pipeline: run.pipeline_title for run in runs}
    holding = {
        name: _holding([run.verdict for run in mine])
        for name in titles
        if (mine := [cell.run for (pipeline, _), cell in cells.items() if pipeline == name])
    }
    return Section(
        "matrix",
        "Scenes and pipelines",
        "matrix.html",
        {"scenes": report.scenes, "titles": titles, "cells": cells, "holding": holding, "verdicts": VERDICTS},
    )


def _cell(report: Report, run: RunRecord) -> Cell:
    last = run.stages[-1] if run.stages else None
    return Cell(
        run, report.link(run), last.cost if last else None, [part for part in end_of(last, run.scene).split(", ") if part] if last else []
    )


def _holding(verdicts: list[str]) -> Holding:
    able = [word for word in verdicts if word not in ("not applicable", "consistent")]
    return Holding(sum(word in HOLD for word in able), len(able), able.count("holds with feedback"))
