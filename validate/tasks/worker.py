"""Worker: one child process per task, and a record of its ending.

    record = Worker(task, provenance, store).run(wanted=lambda: True)   # always a stored record

The child runs in its own session, with output in log.txt. Only its result file counts, not its exit
code.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from pydantic import ValidationError

from models.errors import MachineError
from models.results.run import ProvenanceRecord, RunRecord
from models.results.stored import record_of, to_data, to_json
from validate.processes.disk import disk_error, refusals_in_words, remove, tail, write_durably
from validate.processes.process import TEMPORARY, Child, Ended, Preloaded, exit_in_words
from validate.store.store import LOG, MACHINE, RECORD, REQUEST, Store, log_in, progress_in
from validate.tasks.check import unfinished_check
from validate.tasks.path import LoadedRun, load_run, unfinished_run, unfinished_survey
from validate.tasks.profile import Profile
from validate.tasks.task import CheckTask, ChildExit, RunTask, Task, TaskRecord, task_to_json

# Longest message about the machine [bytes].
_LONGEST_WORDS = 10_000
# Interval between looks whether a task is wanted and has time [s]; its end is noticed at once.
_LOOK = 0.05
_FUNCTION = "validate.tasks.child:main"


class Worker:
    """One running task.

    - loaded: the run, if loaded.
    - preloaded: process to fork the child from.
    - token_begins: at most 16 letters and digits of the campaign.

    Raises MachineError if the folder cannot be written, or no process started.
    """

    def __init__(
        self,
        task: Task,
        provenance: ProvenanceRecord,
        store: Store,
        *,
        loaded: LoadedRun | None = None,
        preloaded: Preloaded | None = None,
        token_begins: str = "",
    ) -> None:
        self._task, self._provenance, self._store, self._loaded = task, provenance, store, loaded
        self._folder = store.open_partial(task.key, token_begins).resolve()
        try:
            write_request(self._folder, task, provenance)
            with refusals_in_words(self._folder):
                (self._folder / TEMPORARY).mkdir()
                (self._folder / LOG).touch()
            self._child = Child(
                _FUNCTION, self._folder, output=self._folder / LOG, preloaded=preloaded
            )
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        self._began = time.monotonic()
        # A survey replaces only the record of a stored run.
        self._amends = isinstance(task, RunTask) and bool(task.worlds)

    def run(self, wanted: Callable[[], bool]) -> TaskRecord | None:
        """Return the stored record, or None and no trace if no longer wanted.

        Raises MachineError if this machine cannot run the task.
        """
        with closing(self._child) as child:
            while wanted():
                has_ended = child.wait(_LOOK)
                if has_ended or time.monotonic() - self._began > self._task.time_limit:
                    record = self._record(child.end(), over_time=not has_ended)
                    self._file(record)
                    return record
            return None

    def _file(self, record: TaskRecord) -> None:
        if self._amends and (self._store.runs / record.key).is_dir():
            write_durably(self._store.runs / record.key / RECORD, to_json(record))
            return
        has_plan = isinstance(record, RunRecord) and any(stage.has_plan for stage in record.stages)
        for path in tuple(self._folder.iterdir()):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name not in {RECORD, LOG, REQUEST} and not (
                has_plan and path.suffix == ".nc"
            ):
                remove(path)
        self._store.commit(self._folder, record.key)

    def _record(self, ended: Ended, *, over_time: bool) -> TaskRecord:
        """Return the child's record if complete, else one of its ending."""
        problem = ""
        try:
            record = record_of((self._folder / RECORD).read_bytes())
            if record.key == self._task.key:
                return record
            problem = "its result file belongs to another task"
        except FileNotFoundError:
            problem = "it left no result" if ended.code == 0 else ""
        except (OSError, ValidationError) as error:
            problem = f"its result file cannot be read ({type(error).__name__})"
        if os.path.lexists(self._folder / MACHINE):
            raise self._machine()
        return self._without_record(ended, problem, over_time=over_time)

    def _machine(self) -> MachineError:
        text = tail(self._folder / MACHINE, _LONGEST_WORDS)
        whole = text.endswith("\n") and text.strip()
        return (
            MachineError(text.strip())
            if whole
            else disk_error(self._folder, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        )

    def _without_record(self, ended: Ended, problem: str, *, over_time: bool) -> TaskRecord:
        place, log = progress_in(self._folder), log_in(self._folder)
        if over_time:
            message = f"ended at its time limit of {self._task.time_limit:g} s, during {place}."
        else:
            words = (
                f"the process ended with {exit_in_words(ended.code)} during {place}",
                problem,
                _last_line(log, ended.code),
            )
            message = "; ".join(filter(None, words)) + "."
        outcome, wall = "time_limit" if over_time else "crashed", time.monotonic() - self._began
        child = ChildExit(outcome=outcome, message=message, wall=wall, cpu=ended.cpu, log=log)
        if isinstance(self._task, RunTask) and self._amends:
            run = self._store.read(self._task.key)
            if isinstance(run, RunRecord):
                return unfinished_survey(self._task, run, child)
        record = record_for_crash(self._task, self._provenance, child, self._folder, self._loaded)
        write_durably(self._folder / RECORD, to_json(record))
        return record


def write_request(folder: Path, task: Task, provenance: ProvenanceRecord) -> None:
    """Write a task's request into its folder. Raises MachineError."""
    request = {"task": task_to_json(task), "provenance": to_data(provenance)}
    write_durably(folder / REQUEST, json.dumps(request, indent=1))


def record_for_crash(
    task: Task,
    provenance: ProvenanceRecord,
    child: ChildExit,
    folder: Path,
    loaded: LoadedRun | None = None,
) -> TaskRecord:
    """Return the record of a task whose child left none.

    loaded: the run, if loaded, because its scene file may have changed.
    """
    if isinstance(task, CheckTask):
        return unfinished_check(task, provenance, child)
    return unfinished_run(
        task, loaded or load_run(task, Profile(time.monotonic())), provenance, child, folder
    )


def _last_line(log: str, code: int) -> str:
    """Return the log's last line after a Python traceback, else ""."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    return (
        f"its last log line: {lines[-1][:300]}" if code > 0 and lines and "Traceback" in log else ""
    )
