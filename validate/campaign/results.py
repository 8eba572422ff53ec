"""Write the tables of a campaign from its records.

    write_tables(Path("runs/all"), runs, checks, violation)

- results.csv: one row for each stage
- checks.csv: one row for each check
- violation.csv: one row for each relaxation and eps
- plans.csv: one row for each foreign plan

Numbers are written in full (repr), unknown values are empty, rows are in task order. On one
machine, files of the same tasks differ only in columns ending in `_s` (seconds).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from models.results.check import CheckRecord
from models.results.robustness import Survey
from models.results.run import OWN_STEP, RunRecord, StageRecord, ViolationPoint
from reports.foreign import answers
from validate.judge.score import metric_names
from validate.processes.disk import remove, write_durably

TABLES = RESULTS, CHECKS, VIOLATION, PLANS = (
    "results.csv",
    "checks.csv",
    "violation.csv",
    "plans.csv",
)
_METRICS_FIRST = (
    "terminal_error",
    "physics",
    "physics_scaled",
    "defect",
    "discrete_terminal_error",
    "replay_terminal_error",
    "replay_terminal_position_error",
    "replay_terminal_velocity_error",
)
_METRICS_LAST = (
    "replay_error",
    "max_penetration",
    "ghost_impulse",
    "missed_impulse",
)
# Metrics of the replay with feedback.
_METRICS_FEEDBACK = (
    "tracked_replay_terminal_error",
    "tracked_replay_error",
    "feedback_effort",
    "feedback_share",
)
_COLUMNS = (
    *("scene", "pipeline", "stage", "method", "eps", "outcome", "cost"),
    *_METRICS_FIRST,
    *_METRICS_LAST,
    *(
        "verdict",
        "iterations",
        "build_s",
        "solve_s",
        "stage_s",
        "stage_cpu_s",
        "total_s",
        "replay_s",
    ),
    *("judged", *_METRICS_FEEDBACK, "growth_rate"),
)
# All other metrics that can have limits, in the order of the table.
_METRICS_MORE = tuple(name for name in metric_names() if name not in _COLUMNS)
# Columns of plans that hold: number of worlds, shares that arrive, and the weakest perturbation
# with the largest number of sizes that the plan tolerates.
_SURVEY = ("worlds", "share_arriving", "share_arriving_with_feedback", "weakest", "weakest_sizes")
COLUMNS = (*_COLUMNS, *_METRICS_MORE, *_SURVEY)
_VIOLATION_COLUMNS = ("law", "eps", "measured", "closed_form", "relative_difference")


def rows(records: Iterable[RunRecord]) -> list[dict[str, Any]]:
    """Return one dictionary for each stage, by column name; unknown values are None.

    Stages are counted from 1.
    """
    return [_row(record, stage) for record in records for stage in record.stages]


def _row(record: RunRecord, stage: StageRecord) -> dict[str, Any]:
    metrics = {metric.name: metric.value for metric in stage.metrics}
    spent = stage.seconds if stage.seconds.wall > 0 else None
    return {
        "scene": record.scene.name,
        "pipeline": record.pipeline,
        "stage": stage.index + 1,
        "method": stage.method,
        "eps": stage.eps,
        "outcome": stage.outcome,
        "cost": stage.cost,
        **{
            name: metrics.get(name)
            for name in (*_METRICS_FIRST, *_METRICS_LAST, *_METRICS_FEEDBACK, *_METRICS_MORE)
        },
        "verdict": stage.verdict,
        "iterations": stage.iterations if spent else None,
        "build_s": spent.build + spent.translate if spent else None,
        "solve_s": spent.solve if spent else None,
        "stage_s": spent.wall if spent else None,
        "stage_cpu_s": spent.cpu if spent else None,
        "total_s": spent.total if spent else None,
        "replay_s": spent.replay if spent else None,
        "judged": stage.replay.judged if stage.replay is not None else None,
        "growth_rate": stage.replay.growth_rate if stage.replay is not None else None,
        **dict(zip(_SURVEY, _survey(stage.survey), strict=True)),
    }


def _survey(found: Survey | None) -> tuple[Any, ...]:
    if found is None or found.alone is None:
        return (None,) * len(_SURVEY)
    return (
        found.alone.samples,
        found.alone.share,
        None if found.feedback is None else found.feedback.share,
        found.weakest,
        found.sizes,
    )


def check_rows(records: Iterable[CheckRecord]) -> list[dict[str, Any]]:
    """Return one dictionary for each check, by column name.

    message: the finding, or the reason for a missing answer.
    """
    return [
        {
            "kind": record.kind,
            "name": record.name,
            "scene": record.scene,
            "outcome": record.outcome,
            "passed": record.passed,
            "message": record.found or record.message,
            "wall_s": record.wall_seconds,
            "cpu_s": record.cpu_seconds,
        }
        for record in records
    ]


def plan_rows(runs: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Return one dictionary for each foreign plan, by column name: answers and their figures."""
    return [
        {
            "instance": one.instance,
            "plan": one.plan,
            "own_time_step": one.discrete,
            "own_equations": one.model,
            "physics": one.scene,
            "meaning": one.meaning,
            "cost": one.run.cost,
            "own_time_step_miss": (one.own or one.run).stages[-1].residuals.get(OWN_STEP),
            "own_replay_error": None if one.own is None else _replay_error(one.own),
            "replay_error": _replay_error(one.run),
        }
        for one in answers(runs)
    ]


def _replay_error(run: RunRecord) -> float | None:
    """Return the largest distance from plan to replay."""
    metric = run.stages[-1].judged("replay_error")
    return None if metric is None else metric.value


def tables(
    runs: Sequence[RunRecord], checks: Sequence[CheckRecord], violation: Sequence[ViolationPoint]
) -> dict[str, str]:
    """Return the text of each table by file name, "" for an empty table."""
    return {
        RESULTS: table_text(COLUMNS, rows(runs)),
        CHECKS: _table(check_rows(checks)),
        VIOLATION: table_text(_VIOLATION_COLUMNS, map(_violation_row, violation)),
        PLANS: _table(plan_rows(runs)),
    }


def write_tables(
    folder: Path,
    runs: Sequence[RunRecord],
    checks: Sequence[CheckRecord],
    violation: Sequence[ViolationPoint],
) -> None:
    """Write each table into a campaign's folder, and remove empty ones.

    Raises MachineError if a file cannot be written.
    """
    for name, text in tables(runs, checks, violation).items():
        if text:
            write_durably(folder / name, text)
        else:
            remove(folder / name)


def table_text(columns: Sequence[str], content: Iterable[Mapping[str, Any]]) -> str:
    """Return a table as CSV with numbers in full; missing values are empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(content)
    return text.getvalue()


def _table(found: Sequence[dict[str, Any]]) -> str:
    return table_text(list(found[0]), found) if found else ""


def _violation_row(point: ViolationPoint) -> dict[str, Any]:
    return {
        **asdict(point),
        "relative_difference": abs(point.measured - point.closed_form) / point.closed_form,
    }
