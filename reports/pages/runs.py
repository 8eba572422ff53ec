"""All runs as one table, in the campaign's order: verdict, cost, errors apart, seconds, and why; in a single file with all that is told of each below it."""

from __future__ import annotations

from dataclasses import dataclass

from reports.causes import cause_of
from reports.findings import integral_cost, last_cost, solving_cpu
from reports.judged import judged_metric
from reports.pages.run import RunView, not_applicable, view_of
from reports.pages.section import Report, Section
from reports.records.record import HOLD, MetricRecord, RunRecord
from reports.wording import count


@dataclass(frozen=True)
class Listed:
    """A run as a row. link: of its page; integral: cost times the time step; position, velocity, error: metrics of its judged replay; why: in a few words.

    anchor, view: where it stands and all that is told of it, where that is here.
    """

    run: RunRecord
    link: str
    cost: float | None
    integral: float | None
    position: MetricRecord | None
    velocity: MetricRecord | None
    error: MetricRecord | None
    cpu: float
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
    last, price, cause = run.stages[-1] if run.stages else None, last_cost(run), cause_of(run)
    metrics = [
        judged_metric(last, f"replay_{name}") if last else None for name in ("terminal_position_error", "terminal_velocity_error", "error")
    ]
    why = cause.sentence if cause is not None else not_applicable(run)
    view = view_of(report, run) if report.single else None
    return Listed(
        run,
        report.link(run),
        price,
        integral_cost(run.scene, price),
        metrics[0],
        metrics[1],
        metrics[2],
        solving_cpu(run),
        why,
        report.anchor(run),
        view,
    )
