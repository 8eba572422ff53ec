"""Our own FMUs under our own check: a check for each scene of a campaign and each version of FMI.

The FMU is exported and checked as `python -m validate fmu` and `check` do: its code runs in an
isolated child, each check in a fork.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.catalog import load_scene
from models.fmu import build_fmu
from models.scene.text import scene_text
from reports.records.check_record import CheckRow, FmuRecord
from validate.tasks.check import Course, Found
from validate.tasks.task import CheckTask, SceneReference

if TYPE_CHECKING:
    from validate.fmu_check import CheckReport

VERSIONS = ("2.0", "3.0")
# What a quick campaign runs: the version that its replays use, too.
_QUICK = "2.0"
_SOURCES = (
    "models/",
    "validate/fmu_check/",
    "validate/execution/isolated",
    "validate/execution/process.py",
    "validate/fmi/",
    "validate/tasks/fmu_checks.py",
)


def checks(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    """One for each scene and version; all scenes of one version, then of the next."""
    return [
        CheckTask(
            kind="FMU",
            name=f"{reference.scene.name}, FMI {version}",
            group=f"FMU, FMI {version}",
            expected="it passes every check of what it offers.",
            function="validate.tasks.fmu_checks:check",
            arguments={"scene": reference.where, "version": version},
            content=scene_text(reference.scene),
            sources=_SOURCES,
            scene=reference.scene.name,
            quick=version == _QUICK,
            words=("fmu_check", f"fmi{version[0]}"),
        )
        for version in VERSIONS
        for reference in scenes
    ]


def check(arguments: Mapping[str, Any], course: Course) -> Found:
    """Export and check.

    Raises MachineError, SceneError for a scene whose names an FMU cannot carry.
    """
    from validate.fmu_check import CHECK_SECONDS, check_fmu  # imports FMPy: in the child alone

    began = time.perf_counter()
    course.at("the export")
    path = build_fmu(load_scene(arguments["scene"]), arguments["version"])
    exported = time.perf_counter()
    course.at("the check")
    report = check_fmu(path, seconds=min(CHECK_SECONDS, course.seconds_left))
    checked = time.perf_counter()
    return found_by(report, path, exported - began, checked - exported)


def found_by(report: CheckReport, path: Path, export_seconds: float, check_seconds: float) -> Found:
    """What a check of the FMU in a file found, as a record has it.

    The sentence names what failed.
    """
    data = path.read_bytes()
    rows = tuple(
        CheckRow(**{**asdict(row), "status": row.status.value, "severity": row.severity})
        for row in report.rows
    )
    failed = [
        f"{row.name}{f' ({row.type})' if row.type else ''}: {row.sentence}"
        for row in report.failures()
    ]
    record = FmuRecord(
        version=report.version,
        types=report.types,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        export_seconds=export_seconds,
        check_seconds=check_seconds,
        rows=rows,
    )
    missing = "there is no binary for this machine" if report.unrunnable else ""
    sentence = (
        "; ".join(filter(None, [*(text.rstrip(".") for text in failed), missing, report.counts]))
        + "."
    )
    return Found(
        passed=report.ok and not report.unrunnable, sentence=sentence, details={"fmu": record}
    )
