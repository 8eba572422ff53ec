"""Engines run the cells of a campaign, each in its own child process, and hand back records as cells finish.

    with open_engine("local", 2, site, len(cells)) as engine:       # or "dask", "dask:ADDRESS", "dask:FILE.json": validate.execution.dask
        for cell, record in engine.run(cells): ...

Another engine is another class with the same `run`: it has a Worker run where a cell is to run, and a Worker stores what it finished by itself.
"""

from __future__ import annotations

import importlib.util
import json
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from models.errors import MachineError, TouchstoneError

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import ProvenanceRecord, RunRecord
    from validate.execution.worker import Job, Lost, Worker
    from validate.store.store import Store

LOCAL, DASK = "local", "dask"
# How often children are looked at [s]: far below the 0.3 s a cell takes to start, and 20 cheap system calls a second.
_LOOK = 0.05


class EngineError(TouchstoneError):
    """No engine has this name, or its cluster is not described where the name says."""


class Running(Protocol):
    """A cell at work, as it is told of."""

    @property
    def cell(self) -> Job: ...
    def progress(self) -> str: ...


class Engine(Protocol):
    def run(self, cells: Sequence[Job]) -> Generator[tuple[Job, RunRecord | ExaminationRecord], None, None]:
        """Run all cells; yield each with its record when it has finished. Closing the iterator stops what runs."""
        ...


@dataclass(frozen=True, kw_only=True)
class Site:
    """What an engine has of a campaign. lost: makes the record of a child of a cell that left none; watch: called with what runs at each
    look; must_wait: whether a cell is to be left for later while others run; again: whether a cell with this record is to be run once more; warn:
    told a sentence."""

    store: Store
    provenance: ProvenanceRecord
    lost: Callable[[Job], Callable[[Lost, Path], RunRecord | ExaminationRecord]]
    watch: Callable[[Sequence[Running]], None]
    must_wait: Callable[[Job, Sequence[Job]], bool]
    again: Callable[[RunRecord | ExaminationRecord], bool]
    warn: Callable[[str], None]


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


@contextmanager
def open_engine(name: str, jobs: int | None, site: Site, cells: int) -> Iterator[Engine]:
    """The engine of a name. jobs: cells at a time, None for what the engine chooses; cells: how many there are. Raises MachineError."""
    if name == LOCAL:
        with _local(jobs or 1, site, cells) as engine:
            yield engine
    else:
        from validate.execution.dask import open_dask

        with open_dask(name.partition(":")[2], jobs, site) as engine:
            yield engine


@contextmanager
def _local(jobs: int, site: Site, cells: int) -> Iterator[LocalEngine]:
    from validate.execution.fork_server import fork_server
    from validate.execution.worker import Watchdog, Worker

    with Watchdog() as watchdog, fork_server(cells) as server:

        def start(cell: Job) -> Worker:
            return Worker(cell, site.lost(cell), site.provenance, site.store, watchdog, server)

        yield LocalEngine(start, jobs, site.watch, site.must_wait, site.again)


class LocalEngine:
    """At most `jobs` children at a time on this machine, started and watched from this one thread.

    (From one thread because Linux kills a child when the thread that started it ends.) watch: called with the running workers at
    each look; must_wait: whether a cell is to be left for later while others run; again: whether one with this record is to be run once more.
    """

    def __init__(
        self,
        start: Callable[[Job], Worker],
        jobs: int,
        watch: Callable[[Sequence[Worker]], None] = lambda workers: None,
        must_wait: Callable[[Job, Sequence[Job]], bool] = lambda cell, running: False,
        again: Callable[[RunRecord | ExaminationRecord], bool] = lambda record: False,
    ) -> None:
        self._start, self._jobs, self._watch, self._must_wait, self._again = start, jobs, watch, must_wait, again

    def run(self, cells: Sequence[Job]) -> Generator[tuple[Job, RunRecord | ExaminationRecord], None, None]:
        waiting = deque(cells)
        running: list[Worker] = []
        try:
            while waiting or running:
                while len(running) < self._jobs and (cell := self._next(waiting, running)) is not None:
                    running.append(self._start(cell))
                self._watch(running)
                time.sleep(_LOOK)
                for worker in tuple(running):
                    record = worker.poll()
                    if record is not None:
                        running.remove(worker)
                        if self._again(record):
                            waiting.appendleft(worker.cell)
                        else:
                            yield worker.cell, record
        finally:
            for worker in running:
                worker.stop()

    def _next(self, waiting: deque[Job], running: Sequence[Worker]) -> Job | None:
        """The first cell that may run beside these; taken out."""
        at_work = [worker.cell for worker in running]
        for cell in waiting:
            if not at_work or not self._must_wait(cell, at_work):
                waiting.remove(cell)
                return cell
        return None
