"""results.csv: one row a stage, and checks.csv: one row a check.

Rebuilt from records at any time, numbers in full (repr), nothing where nothing is known.

Rows stand in the order of the campaign's tasks; apart from the columns whose names end in `_s`
(seconds) the file is the same bytes whenever the same tasks are run on the same machine.

violation.csv: one row a relaxation and eps. plans.csv: one row a foreign plan.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from reports.foreign import answers
from reports.records.check_record import CheckRecord
from reports.records.record import (
    OWN_STEP,
    RunRecord,
    StageRecord,
    SurveyRecord,
    ViolationPoint,
)
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
    "energy_residual",
)
# Of the replay with feedback, and which of the two replays the verdict is on.
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
# Every other metric that can be limited, in the order of the table.
_METRICS_MORE = tuple(name for name in metric_names() if name not in _COLUMNS)
# Of plans that hold: worlds tried, the shares that arrive, and of which perturbation the plan takes
# how many sizes at most.
_SURVEY = ("worlds", "share_arriving", "share_arriving_with_feedback", "weakest", "weakest_sizes")
COLUMNS = (*_COLUMNS, *_METRICS_MORE, *_SURVEY)
_VIOLATION_COLUMNS = ("law", "eps", "measured", "closed_form", "relative_difference")


def rows(records: Iterable[RunRecord]) -> list[dict[str, Any]]:
    """One dictionary a stage, by column name; None where nothing is known.

    Stages are counted from 1.
    """
    return [_row(record, stage) for record in records for stage in record.stages]


def _row(record: RunRecord, stage: StageRecord) -> dict[str, Any]:
    metrics = {metric.name: metric.value for metric in stage.metrics}
    ran = stage.seconds.stage > 0
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
        "iterations": stage.iterations if ran else None,
        "build_s": stage.seconds.build + stage.seconds.translate if ran else None,
        **{
            f"{name}_s": getattr(stage.seconds, name) if ran else None
            for name in ("solve", "stage", "stage_cpu", "total", "replay")
        },
        "judged": stage.replay.judged if stage.replay is not None else None,
        "growth_rate": stage.replay.growth_rate if stage.replay is not None else None,
        **dict(zip(_SURVEY, _survey(stage.survey), strict=True)),
    }


def _survey(found: SurveyRecord | None) -> tuple[Any, ...]:
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
    """One dictionary a check, by column name.

    message: what was found, or why there is no answer.
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
    """One dictionary a foreign plan, by column name: the three answers and their figures."""
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
    """Return the largest distance of the replay that the verdict is on from the plan."""
    metric = run.stages[-1].judged("replay_error")
    return None if metric is None else metric.value


def tables(
    runs: Sequence[RunRecord], checks: Sequence[CheckRecord], violation: Sequence[ViolationPoint]
) -> dict[str, str]:
    """The text of each table by its file's name; of one that says nothing an empty one."""
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
    """Write each table into a campaign's folder, and remove one that says nothing.

    Raises MachineError if the disk refuses.
    """
    for name, text in tables(runs, checks, violation).items():
        if text:
            write_durably(folder / name, text)
        else:
            remove(folder / name)


def table_text(columns: Sequence[str], content: Iterable[Mapping[str, Any]]) -> str:
    """A table as CSV, numbers in full; what a row does not know is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(content)
    return text.getvalue()


def _table(found: Sequence[dict[str, Any]]) -> str:
    return table_text(list(found[0]), found) if found else ""


def _violation_row(point: ViolationPoint) -> dict[str, Any]:
    return {
        **point.model_dump(),
        "relative_difference": abs(point.measured - point.closed_form) / point.closed_form,
    }
