"""All runs in the campaign's order, each with its verdict, its outcome and what leads to its page; in a single file with all that is told of it."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.run import RunView, view_of
from reports.pages.section import Report, Section
from reports.records.record import RunRecord


@dataclass(frozen=True)
class Listed:
    """A run; link: of its page; view: all that is told of it, where that stands here."""

    run: RunRecord
    anchor: str
    link: str
    view: RunView | None


def build(report: Report) -> Section | None:
    """The section, or None where no run is stored."""
    runs = report.stored.runs
    if not runs:
        return None
    listed = [Listed(run, report.anchor(run), report.link(run), view_of(report, run) if report.single else None) for run in runs]
    # The contents lead to the first run of each scene: hundreds of lines would be none.
    first = {run.scene.name: report.anchor(run) for run in reversed(runs)}
    entries = tuple((first[scene.name], scene.name) for scene in report.scenes) if len(report.scenes) > 1 else ()
    return Section("runs", "Runs", "runs.html", {"listed": listed}, entries)
