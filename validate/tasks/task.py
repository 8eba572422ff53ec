"""A task: what a worker executes, a run or an examination. One child does it; where that leaves no record, its worker writes one.

record = execute(task, provenance, folder, began, profile)          # in the child: validate.execution.child
record = record_for_crash(task, provenance, exit, folder)           # by the worker: validate.execution.worker
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from reports.records.check_record import ExaminationRecord
from reports.records.record import ProvenanceRecord, RunRecord
from validate.tasks.examination import Examination, run_examination, unfinished_examination
from validate.tasks.path import LoadedRun, load_run, run_path, unfinished_run
from validate.tasks.profile import Profile
from validate.tasks.run import ChildExit, RunTask

Task: TypeAlias = RunTask | Examination
TaskRecord: TypeAlias = RunRecord | ExaminationRecord


def task_from_json(data: Mapping[str, Any]) -> Task:
    """The task that was written by its `to_json`."""
    return Examination.from_json(data) if "examination" in data else RunTask.from_json(data)


def execute(task: Task, provenance: ProvenanceRecord, folder: Path, began: float, profile: Profile) -> TaskRecord:
    """The record of a task, made in its folder. began [s]: time.monotonic() at the start of the process; profile: of the process until now.

    Raises MachineError where this machine cannot go on; whatever else goes wrong is in the record.
    """
    if isinstance(task, Examination):
        return run_examination(task, provenance, folder, began)
    profile.lap("imports")
    return run_path(task, provenance, folder, began, profile)


def record_for_crash(
    task: Task, provenance: ProvenanceRecord, child: ChildExit, folder: Path, loaded: LoadedRun | None = None
) -> TaskRecord:
    """The record of a task whose child left none. loaded: of a run, if it is loaded already; a scene file may have changed since."""
    if isinstance(task, Examination):
        return unfinished_examination(task, provenance, child)
    return unfinished_run(task, loaded or load_run(task), provenance, child, folder)
