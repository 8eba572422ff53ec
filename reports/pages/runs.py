"""All runs as one table, in the campaign's order: verdict, cost, errors apart, seconds, and why; in a single file with all that is told of each below it."""

from __future__ import annotations

from dataclasses import dataclass

from reports.causes import cause_of
from reports.pages.run import RunView, not_applicable, view_of
from reports.pages.section import Report, Section
from reports.records.record import HOLD, MetricRecord, RunRecord
from reports.wording import count


@dataclass(frozen=True)
class Listed:
    """A run as a row. link: of its page; errors: of its judged replay, position and velocity at the end, and from the plan; why: in a few words.

    anchor, view: where it stands and all that is told of it, where that is here.
    """

    run: RunRecord
    link: str
    errors: list[MetricRecord | None]
    why: str
    anchor: str
    view: RunView | None


def build(report: Report) -> Section | None:
    """The section, or None where no run is stored."""
    runs = report.stored.runs
    if not runs:
        return None
    listed = [_listed(report, run) for run in runs]
    holding = sum(run.verdict in HOLD for run in runs)
    said = f"{count(len(runs), 'run')} in one table, {holding} of which {'holds' if holding == 1 else 'hold'}: verdict, cost, errors, seconds and why."
    # In a single file the contents lead to the first run of each scene: hundreds of lines would be none.
    first = {run.scene.name: report.anchor(run) for run in reversed(runs)} if report.single else {}
    return Section(
        "runs",
        "All runs",
        "run.html",
        {"listed": listed},
        tuple((first[scene.name], scene.name) for scene in report.scenes if first),
        said,
    )


def _listed(report: Report, run: RunRecord) -> Listed:
    names = ("terminal_position_error", "terminal_velocity_error", "error")
    errors = [run.last.judged(f"replay_{name}") if run.last else None for name in names]
    cause = cause_of(run)
    why = cause.sentence if cause is not None else not_applicable(run)
    return Listed(run, report.link(run), errors, why, report.anchor(run), view_of(report, run) if report.single else None)
