"""results.csv: one row a stage, and examinations.csv: one row an examination; rebuilt from records at any time, numbers in full (repr), nothing where nothing is known.

Rows stand in the order of the campaign's tasks; apart from the columns whose names end in `_s` (seconds) the file is the same bytes whenever
the same tasks are run on the same machine.

starts.csv and front.csv: one row a start, one row a terminal tolerance; rebuilt from records at any time, absent where there are none.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from reports.records.check_record import ExaminationRecord
from reports.records.record import CertificateRecord, RunRecord, StageRecord, ViolationPoint
from validate.judge.score import metric_names
from validate.store.disk import remove, write_durably

RESULTS, EXAMINATIONS, VIOLATION, STARTS, FRONT = "results.csv", "examinations.csv", "violation.csv", "starts.csv", "front.csv"
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
_METRICS_LAST = ("replay_error", "max_penetration", "ghost_impulse", "missed_impulse", "energy_residual")
# Of the replay with feedback, and which of the two replays the verdict is on.
_METRICS_FEEDBACK = ("tracked_replay_terminal_error", "tracked_replay_error", "feedback_effort", "feedback_share")
_COLUMNS = (
    *("scene", "pipeline", "stage", "method", "eps", "outcome", "cost"),
    *_METRICS_FIRST,
    *_METRICS_LAST,
    *("verdict", "iterations", "build_s", "solve_s", "stage_s", "stage_cpu_s", "total_s", "replay_s"),
    *("judged", *_METRICS_FEEDBACK, "growth_rate"),
)
# Every other metric that can be limited, in the order of the table.
_METRICS_MORE = tuple(name for name in metric_names() if name not in _COLUMNS)
COLUMNS = (*_COLUMNS, *_METRICS_MORE)


def rows(records: Iterable[RunRecord]) -> list[dict[str, Any]]:
    """One dictionary a stage, by column name; None where nothing is known. Stages are counted from 1."""
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
        **{name: metrics.get(name) for name in (*_METRICS_FIRST, *_METRICS_LAST)},
        "verdict": stage.verdict,
        "iterations": stage.iterations if ran else None,
        "build_s": stage.seconds.build + stage.seconds.translate if ran else None,
        "solve_s": stage.seconds.solve if ran else None,
        "stage_s": stage.seconds.stage if ran else None,
        "stage_cpu_s": stage.seconds.stage_cpu if ran else None,
        "total_s": stage.seconds.total if ran else None,
        "replay_s": stage.seconds.replay if ran else None,
        "judged": stage.replay.judged if stage.replay is not None else None,
        **{name: metrics.get(name) for name in _METRICS_FEEDBACK},
        "growth_rate": stage.replay.growth_rate if stage.replay is not None else None,
        **{name: metrics.get(name) for name in _METRICS_MORE},
    }


def examination_rows(records: Iterable[ExaminationRecord]) -> list[dict[str, Any]]:
    """One dictionary an examination, by column name; message: what was found, or why there is no answer."""
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


def results_text(records: Iterable[RunRecord]) -> str:
    """The whole file as text."""
    return _text(COLUMNS, rows(records))


def _text(columns: Sequence[str], content: Iterable[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in content:
        writer.writerow({name: _cell(value) for name, value in row.items()})
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)


def write_results(path: Path, records: Iterable[RunRecord]) -> None:
    """Write results.csv. Raises MachineError if the disk refuses."""
    write_durably(path, results_text(records))


def write_examinations(path: Path, records: Iterable[ExaminationRecord]) -> None:
    """Write examinations.csv, or remove it where there are none. Raises MachineError if the disk refuses."""
    write_or_remove(path, examinations_text(records))


def examinations_text(records: Iterable[ExaminationRecord]) -> str:
    """The whole file as text; empty where there are none."""
    return _table(examination_rows(records))


def _table(found: Sequence[dict[str, Any]]) -> str:
    return _text(list(found[0]), found) if found else ""


def write_or_remove(path: Path, text: str) -> None:
    """Write a table, or remove it where it says nothing. Raises MachineError if the disk refuses."""
    if text:
        write_durably(path, text)
    else:
        remove(path)


def write_violation(path: Path, points: Sequence[ViolationPoint]) -> None:
    """Write violation.csv. Raises MachineError if the disk refuses."""
    write_durably(path, violation_text(points))


def violation_text(points: Sequence[ViolationPoint]) -> str:
    """violation.csv: law, eps, measured, closed form and their relative difference."""
    return _text(
        ("law", "eps", "measured", "closed_form", "relative_difference"),
        (
            {
                "law": point.law,
                "eps": point.eps,
                "measured": point.measured,
                "closed_form": point.closed_form,
                "relative_difference": abs(point.measured - point.closed_form) / point.closed_form,
            }
            for point in points
        ),
    )


def write_sweeps(folder: Path, records: Iterable[RunRecord]) -> None:
    """Write both files. Raises MachineError if the disk refuses."""
    records = tuple(records)
    write_or_remove(folder / STARTS, _table(_starts(records)))
    write_or_remove(folder / FRONT, _table(_front(records)))


def _starts(records: tuple[RunRecord, ...]) -> list[dict[str, Any]]:
    return [
        {
            "scene": record.scene.name,
            "pipeline": record.pipeline,
            "start": start.number,
            "from": start.start,
            "outcome": start.outcome,
            "cost": start.cost,
            "windows": _windows(start.windows),
            "cpu_s": start.seconds,
        }
        for record in records
        for stage in record.stages
        for start in stage.starts
    ]


def _front(records: tuple[RunRecord, ...]) -> list[dict[str, Any]]:
    return [
        {
            "scene": record.scene.name,
            "pipeline": record.pipeline,
            "tolerance": point.tolerance,
            "outcome": point.outcome,
            "cost": point.cost,
            "terminal_error": point.terminal_error,
            "windows": _windows(point.windows),
            **_certificate(point.certificate),
        }
        for record in records
        for stage in record.stages
        for point in stage.front
    ]


def _certificate(certificate: CertificateRecord | None) -> dict[str, Any]:
    names = {"primal": "primal", "complementarity": "complementarity", "dual": "dual", "class": "letter"}
    return {title: None if certificate is None else getattr(certificate, name) for title, name in names.items()}


def _windows(windows: tuple[tuple[str, int, int], ...]) -> str:
    return " ".join(f"{contact}:{first}-{last}" for contact, first, last in windows)
