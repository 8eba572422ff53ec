"""One child process a cell: started, watched, ended, and its end put into words.

    record = Worker(cell, lost, provenance, store).run(wanted=lambda: True)          # a record whatever happened, already stored

The child runs in a session of its own, with its output in log.txt and nothing but its result file believed: a process
that exits with 0 and leaves no record has crashed; one that left a whole record has answered, whatever its exit code.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from models.errors import MachineError
from validate.execution import reaper
from validate.execution.process import ChildProcess, Ended, ForkServerError, exit_in_words, shared_watchdog
from validate.store.disk import disk_error, remove, write_durably
from validate.store.store import LOG, MACHINE, PROGRESS, RECORD, REQUEST, Store
from validate.tasks.run import ChildExit

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import ProvenanceRecord, RunRecord
    from validate.execution.fork_server import ForkServer

_TAIL_BYTES = 20_000
_TEMPORARY = "tmp"
_TOKEN = 32
# How often a child is looked at [s]: for its time limit, and for what it has cost; its end is seen at once.
_LOOK = 0.05


class Job(Protocol):
    """What a child is asked to do: a Cell, or an Examination."""

    @property
    def key(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def time_limit(self) -> float: ...
    def to_json(self) -> dict[str, Any]: ...


class Worker:
    """One running cell; see the module docstring. lost: makes the record of a child that left none; server: forks the child, if there is
    one; token_begins: at most 16 letters and digits by which a campaign knows its own.

    Starting it raises MachineError if the folder cannot be written, or no process can be started.
    """

    def __init__(
        self,
        cell: Job,
        lost: Callable[[ChildExit, Path], RunRecord | ExaminationRecord],
        provenance: ProvenanceRecord,
        store: Store,
        server: ForkServer | None = None,
        token_begins: str = "",
    ) -> None:
        self.cell, self._lost, self._provenance, self._store, self._server = cell, lost, provenance, store, server
        self._token = (token_begins + uuid.uuid4().hex)[:_TOKEN]
        self._ended = Ended(code=0, cpu=0.0, memory=0, strays=0)
        self._folder = store.open_partial(cell.key, self._token).resolve()
        shared_watchdog().tell("start", self._token, str(self._folder))
        self._began = time.monotonic()
        try:
            self._process = self._start()
        except BaseException as error:
            reaper.end_all(self._token)
            self._forget()
            if isinstance(error, OSError):
                raise MachineError(f"a process for {cell.title} cannot be started ({error.strerror}); end what is not needed.") from error
            raise

    def run(self, wanted: Callable[[], bool]) -> RunRecord | ExaminationRecord | None:
        """Its record, which is stored; None if it was not wanted any more, and nothing is left of it. Raises MachineError as `poll`."""
        try:
            while wanted():
                self._process.wait(_LOOK)
                if (record := self.poll()) is not None:
                    return record
        except BaseException:
            self.stop()
            raise
        self.stop()
        return None

    def _start(self) -> ChildProcess:
        request = {"cell": self.cell.to_json(), "provenance": self._provenance.model_dump(mode="json")}
        write_durably(self._folder / REQUEST, json.dumps(request, indent=1))
        temporary = self._folder / _TEMPORARY
        try:
            temporary.mkdir()
            log = open(self._folder / LOG, "wb")  # noqa: SIM115 - closed below, once the child has it
        except OSError as error:
            raise disk_error(self._folder, error) from error
        with log:
            if self._server is not None:
                with contextlib.suppress(ForkServerError):
                    return self._server.start(self._folder, token=self._token, temporary=temporary, log=self._folder / LOG)
            return ChildProcess("validate.execution.child", [str(self._folder)], token=self._token, temporary=temporary, output=log)

    def progress(self) -> str:
        """Where the cell is, in words."""
        return progress_in(self._folder)

    def poll(self) -> RunRecord | ExaminationRecord | None:
        """None while it runs; then its record, which is stored. Raises MachineError if the cell found that this machine cannot."""
        over_time = time.monotonic() - self._began > self.cell.time_limit
        ended = self._process.has_ended()
        if not ended and not over_time:
            self._process.look()
            return None
        self._ended = self._process.end()
        record = self._record(None if ended else "time_limit")
        try:
            self._file(record)
        finally:
            self._forget()
        return record

    def stop(self) -> None:
        """End the cell and leave nothing of it."""
        self._ended = self._process.end()
        self._forget()

    def _forget(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        shared_watchdog().tell("stop", self._token)

    def _file(self, record: RunRecord | ExaminationRecord) -> None:
        answered = any(stage.has_plan for stage in getattr(record, "stages", ()))
        for path in tuple(self._folder.iterdir()):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name not in {RECORD, LOG, REQUEST} and not (answered and path.suffix == ".nc"):
                remove(path)
        self._store.commit(self._folder, record.key)

    def _record(self, ended_by: str | None) -> RunRecord | ExaminationRecord:
        """The child's record if it is whole, else one that says how the child ended."""
        from pydantic import ValidationError

        from reports.records.check_record import StoredRecord

        problem = ""
        try:
            record = StoredRecord.model_validate_json((self._folder / RECORD).read_bytes()).root
            if record.key == self.cell.key:
                return record
            problem = "its result file belongs to another cell"
        except FileNotFoundError:
            problem = "it left no result" if self._ended.code == 0 else ""
        except (OSError, ValidationError) as error:
            problem = f"its result file cannot be read ({type(error).__name__})"
        with contextlib.suppress(FileNotFoundError):
            raise self._machine()
        return self._failure(ended_by, problem)

    def _machine(self) -> MachineError:
        """Why the child says that this machine cannot. Raises FileNotFoundError if it says nothing of it."""
        try:
            text = (self._folder / MACHINE).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise
        except (OSError, ValueError):
            text = ""
        whole = text.endswith("\n") and text.strip()
        return MachineError(text.strip()) if whole else disk_error(self._folder, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    def _failure(self, ended_by: str | None, problem: str) -> RunRecord | ExaminationRecord:
        place = self.progress()
        log = self._log()
        if ended_by == "time_limit":
            outcome = "time_limit"
            message = f"ended at its time limit of {self.cell.time_limit:g} s, during {place}."
        else:
            outcome = "crashed"
            words = [
                f"the process ended with {exit_in_words(self._ended.code)} during {place}",
                problem,
                _last_words(log, self._ended.code),
            ]
            message = "; ".join(filter(None, words)) + "."
        wall = time.monotonic() - self._began
        lost = ChildExit(outcome=outcome, message=message, wall=wall, cpu=self._ended.cpu, log=log)
        record = self._lost(lost, self._folder)
        write_durably(self._folder / RECORD, record.model_dump_json(indent=1))
        return record

    def _log(self) -> str:
        try:
            with open(self._folder / LOG, "rb") as file:
                file.seek(max(0, os.path.getsize(self._folder / LOG) - _TAIL_BYTES))
                return file.read().decode("utf-8", errors="replace")
        except OSError as error:
            raise disk_error(self._folder / LOG, error) from error


def progress_in(folder: Path) -> str:
    """Where the cell is whose unfinished folder this is, in words."""
    try:
        return (folder / PROGRESS).read_text(encoding="utf-8")
    except OSError:
        return "its start"


def _last_words(log: str, code: int) -> str:
    """The last line of the log where it tells why: that of a Python traceback."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    return f"its last log line: {lines[-1][:300]}" if code > 0 and lines and "Traceback" in log else ""
