"""starts.csv and front.csv: one row a start, one row a terminal tolerance; rebuilt from records at any time, absent where there are none."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from reports.record import CertificateRecord, RunRecord
from validate.disk import remove, write_durably

STARTS, FRONT = "starts.csv", "front.csv"


def write_sweeps(folder: Path, records: Iterable[RunRecord]) -> None:
    """Write both files. Raises MachineError if the disk refuses."""
    records = tuple(records)
    for name, rows in ((STARTS, _starts(records)), (FRONT, _front(records))):
        if rows:
            text = io.StringIO()
            writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(
                {key: "" if value is None else repr(value) if isinstance(value, float) else value for key, value in row.items()}
                for row in rows
            )
            write_durably(folder / name, text.getvalue())
        else:
            remove(folder / name)


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
