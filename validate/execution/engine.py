"""Where the cells of a campaign run: executors of concurrent.futures, whose futures are records. What runs when is the campaign's (validate.execution.campaign).

    with open_local(2, context, len(cells)) as engine:       # or validate.execution.dask, open_dask
        future = engine.submit(cell)
        record = engine.result(cell, future)

Another engine is another class with these three: it has a Worker run where a cell is to run, and a Worker stores what it finished by itself.
"""

from __future__ import annotations

import importlib.util
import json
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from models.errors import MachineError, TouchstoneError
from validate.execution.process import interrupts_wait, shared_watchdog, usable_cores
from validate.execution.worker import Job, Worker, progress_in
from validate.store.disk import PARTIAL
from validate.tasks.run import ChildExit

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import ProvenanceRecord, RunRecord
    from validate.execution.fork_server import ForkServer
    from validate.store.store import Store

LOCAL, DASK = "local", "dask"
# In place of a key, in the name of an unfinished folder that is no cell's but the campaign's (validate.execution.dask).
CAMPAIGN = "campaign"


class EngineError(TouchstoneError):
    """No engine has this name, or its cluster is not described where the name says."""


@dataclass(frozen=True, kw_only=True)
class ExecutionContext:
    """What an engine has of a campaign. lost: makes the record of a child of a cell that left none; token: 16 letters and digits, by which
    the campaign knows its own unfinished folders."""

    store: Store
    provenance: ProvenanceRecord
    lost: Callable[[Job], Callable[[ChildExit, Path], RunRecord | ExaminationRecord]]
    token: str

    def unfinished(self) -> list[Path]:
        """Folders of the campaign's cells that are being written."""
        return [path for path in self.store.runs.glob(f"{PARTIAL}*-{self.token}*") if not path.name.startswith(f"{PARTIAL}{CAMPAIGN}-")]


@dataclass(frozen=True, kw_only=True)
class Running:
    """A cell at work, and its unfinished folder."""

    cell: Job
    folder: Path

    def progress(self) -> str:
        """Where the cell is, in words."""
        return progress_in(self.folder)


class Engine(Protocol):
    """jobs: how many cells it is to be given at a time; None: as many as may run."""

    @property
    def jobs(self) -> int | None: ...

    def submit(self, cell: Job) -> Future[RunRecord | ExaminationRecord | None]:
        """Have a cell run. Raises MachineError."""
        ...

    def result(self, cell: Job, future: Future[RunRecord | ExaminationRecord | None]) -> RunRecord | ExaminationRecord | None:
        """What came of it, stored; None if it is to be submitted anew. Raises MachineError if this machine, or its own, cannot."""
        ...

    def why_idle(self, submitted: int) -> str:
        """A sentence why none of what was submitted has begun for a while; empty if nothing is the matter."""
        ...


def check_engine(name: str) -> None:
    """Raises EngineError if there is no such engine, MachineError if what it needs is not installed."""
    kind, colon, where = name.partition(":")
    if name == LOCAL:
        return
    if kind != DASK or (colon and not where):
        raise EngineError(f"--engine {name}: there is no such engine; the engines are local, dask, dask:ADDRESS and dask:FILE.json.")
    if importlib.util.find_spec("distributed") is None:
        raise MachineError(f"--engine {name} needs the package distributed: pip install 'touchstone-contact[dask]'.")
    if where.endswith(".json"):
        _check_scheduler_file(Path(where))


def _check_scheduler_file(path: Path) -> None:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:  # not there, no JSON, or nested without end
        why = error.strerror if isinstance(error, OSError) else "it is no JSON"
        raise EngineError(f"--engine dask:{path}: the scheduler file cannot be read ({why}); start a scheduler that writes it.") from error
    if not isinstance(content, dict) or not isinstance(content.get("address"), str):
        raise EngineError(
            f"--engine dask:{path}: this is no scheduler file of Dask (it has no `address`); give the one the scheduler wrote."
        )


def new_token() -> str:
    """A campaign's."""
    return uuid.uuid4().hex[:16]


@contextmanager
def open_local(jobs: int | None, context: ExecutionContext, cells: int) -> Iterator[Engine]:
    """The engine of this machine; at the end, what runs is stopped. jobs: cells at a time (None: one a core); cells: how many there are. Raises MachineError."""
    from validate.execution.fork_server import fork_server

    shared_watchdog()  # before there are threads that might each start one
    with fork_server(cells) as server:
        engine = LocalEngine(jobs or usable_cores(), context, server)
        try:
            yield engine
        finally:
            with interrupts_wait():
                engine.close()


class LocalEngine:
    """Children on this machine, each watched by the thread that started it. (Linux kills a child when that thread ends.)"""

    def __init__(self, jobs: int, site: ExecutionContext, server: ForkServer | None) -> None:
        self.jobs, self._site, self._server = jobs, site, server
        self._threads, self._closed = ThreadPoolExecutor(jobs), threading.Event()

    def submit(self, cell: Job) -> Future[RunRecord | ExaminationRecord | None]:
        return self._threads.submit(self._run, cell)

    def _run(self, cell: Job) -> RunRecord | ExaminationRecord | None:
        site = self._site
        worker = Worker(cell, site.lost(cell), site.provenance, site.store, self._server, token_begins=site.token)
        return worker.run(lambda: not self._closed.is_set())

    def result(self, cell: Job, future: Future[RunRecord | ExaminationRecord | None]) -> RunRecord | ExaminationRecord | None:
        return future.result()

    def why_idle(self, submitted: int) -> str:
        return ""

    def close(self) -> None:
        """End what runs, and leave nothing of it."""
        self._closed.set()
        self._threads.shutdown(cancel_futures=True)
