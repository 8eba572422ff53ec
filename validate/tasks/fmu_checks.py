"""Decisive FMU checks of each scene of a campaign, as by `python -m validate fmu` and `check`.

The FMU's code runs in an isolated child, each check in a fork.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.catalog import load_scene
from models.fmu import build_fmu
from models.results.check import FmuRecord
from models.scene.text import scene_text
from validate.tasks.check import Course, Found
from validate.tasks.task import CheckTask, SceneReference

if TYPE_CHECKING:
    from validate.fmu_check import CheckReport

# FMI version of replays.
_VERSION = "2.0"
_SOURCES = (
    "models/",
    "validate/fmu_check/",
    "validate/processes/isolated",
    "validate/processes/process.py",
    "validate/fmi/",
    "validate/tasks/fmu_checks.py",
)


def checks(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    """Return one check per scene."""
    return [
        CheckTask(
            kind="FMU",
            name=f"{reference.scene.name}, FMI {_VERSION}",
            group="FMU",
            expected="it passes the checks that decide whether its replays can be trusted.",
            function="validate.tasks.fmu_checks:check",
            arguments={"scene": reference.where},
            content=scene_text(reference.scene),
            sources=_SOURCES,
            scene=reference.scene.name,
            words=("fmu_check",),
        )
        for reference in scenes
    ]


def check(arguments: Mapping[str, Any], course: Course) -> Found:
    """Export and check. Raises MachineError, and SceneError for names that FMI forbids."""
    from validate.fmu_check import (
        CHECK_SECONDS,
        DECISIVE,
        check_fmu,
    )  # imports FMPy, only in the child

    began = time.perf_counter()
    course.at("the export")
    path = build_fmu(load_scene(arguments["scene"]), _VERSION)
    exported = time.perf_counter()
    course.at("the check")
    report = check_fmu(path, names=DECISIVE, seconds=min(CHECK_SECONDS, course.seconds_left))
    checked = time.perf_counter()
    return found_by(report, path, exported - began, checked - exported)


def found_by(report: CheckReport, path: Path, export_seconds: float, check_seconds: float) -> Found:
    """Return the finding of a report, whose sentence names the failures."""
    data = path.read_bytes()
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
        rows=report.rows,
    )
    missing = "there is no binary for this machine" if report.unrunnable else ""
    sentence = (
        "; ".join(filter(None, [*(text.rstrip(".") for text in failed), missing, report.counts]))
        + "."
    )
    return Found(
        passed=report.ok and not report.unrunnable, sentence=sentence, details={"fmu": record}
    )
