"""Checks: a function is called in a child, and its finding passes or not.

    CheckTask(kind="FMU", name="three_cart, FMI 2.0", expected="...",
              function="validate.tasks.fmu_checks:check",
              arguments={"scene": "three_cart", "version": "2.0"}, ...)

A function `checks(scenes)` lists the checks of a room (validate.tasks.plugins, CHECKS). The
campaign selects, keys, runs, stores, resumes and reports them like runs; function(arguments,
course) returns a Found.
"""

from __future__ import annotations

import importlib
import os
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models.errors import MachineError, TouchstoneError
from models.results.check import CheckRecord
from models.results.run import ProvenanceRecord
from models.results.verdict import Metric
from validate.processes.disk import raise_if_disk_ended
from validate.store.provenance import function_key
from validate.store.store import log_in, progress
from validate.tasks.records import LOG_LINES
from validate.tasks.stage import in_words
from validate.tasks.task import CheckTask, ChildExit

# Share of a check's time limit reserved for its record.
_WRITING_SHARE = 0.05
# Largest such time [s].
_WRITING_MOST = 5.0


def check_key(task: CheckTask) -> str:
    """Return the key of a check, by its request, content and sources."""
    request = [task.kind, task.name, task.expected, task.function, dict(task.arguments)]
    sources = (
        ("validate/tasks/check.py", "models/results/", "reports/", *task.sources)
        if task.sources
        else ()
    )
    return function_key(request, task.content, task.methods, sources)


@dataclass(frozen=True)
class Found:
    """Finding of a check, in one sentence; details: further fields of the record."""

    passed: bool
    sentence: str
    figures: tuple[Metric, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Course:
    """Context of a check: folder for scratch files, and the deadline by time.monotonic()."""

    folder: Path
    deadline: float

    def at(self, text: str) -> None:
        """Report progress, for the parent of a failed child."""
        progress(self.folder, text)

    @property
    def seconds_left(self) -> float:
        """Return the time until the deadline [s]."""
        return max(0.0, self.deadline - time.monotonic())


def run_check(
    task: CheckTask, provenance: ProvenanceRecord, folder: Path, began: float
) -> CheckRecord:
    """Run a check in its child; began: time.monotonic() at its start.

    Raises MachineError; other errors are recorded.
    """
    reserve = min(_WRITING_MOST, _WRITING_SHARE * task.time_limit)
    course = Course(folder, began + task.time_limit - reserve)
    module, _, name = task.function.partition(":")
    found, outcome, message = Found(False, ""), "answered", ""
    try:
        function: Callable[[Mapping[str, Any], Course], Found] = getattr(
            importlib.import_module(module), name
        )
        found = function(task.arguments, course)
    except MachineError:
        raise
    except Exception as error:  # noqa: BLE001 - any failure is recorded, with its traceback in the log
        raise_if_disk_ended(folder, error)
        traceback.print_exc()
        outcome, message = (
            "failed" if isinstance(error, TouchstoneError) else "crashed",
            in_words(error),
        )
    used = os.times()
    cpu = used.user + used.system + used.children_user + used.children_system
    how = ChildExit(
        outcome=outcome, message=message, wall=time.monotonic() - began, cpu=cpu, log=log_in(folder)
    )
    return _record(task, provenance, found, how)


def unfinished_check(
    task: CheckTask, provenance: ProvenanceRecord, child: ChildExit
) -> CheckRecord:
    """Return the record of a check whose child left none."""
    return _record(task, provenance, Found(False, ""), child)


def _record(
    task: CheckTask, provenance: ProvenanceRecord, found: Found, how: ChildExit
) -> CheckRecord:
    return CheckRecord(
        key=task.key,
        kind=task.kind,
        name=task.name,
        expected=task.expected,
        scene=task.scene,
        outcome=how.outcome,
        passed=found.passed,
        found=found.sentence,
        message=how.message,
        figures=found.figures,
        wall_seconds=how.wall,
        cpu_seconds=how.cpu,
        provenance=provenance,
        log_tail="\n".join(how.log.splitlines()[-LOG_LINES:]),
        **found.details,
    )
