"""The engine that runs cells on the workers of a Dask cluster: one of this machine's processes, or one that stands somewhere.

    with open_dask("", 2, site, 100) as engine: ...                 # two worker processes here, which end with the campaign
    with open_dask("tcp://10.0.0.1:8786", None, site, 100) as engine: ...     # or the path of a scheduler file, FILE.json

A cell whose worker is lost is run again by Dask's scheduler, as often as its `allowed-failures` says (3 times); then it has crashed. The scheduler also
counts against a cell that it only waited on a worker that was lost: one that was begun less often is given to it anew. What is left of a
worker that went without a trace is removed when the campaign ends.

A cell runs on a worker as it does here: in a child process, watched by the thread of the Dask task, into the folder of the campaign, which is reached
by its path: campaign and workers share a file system. A worker that sees another folder there, or that has other sources, libraries or another compiler
than the campaign, says so and runs nothing, since a record is filed under a key that all of them decide.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import shutil
import socket
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from models.errors import MachineError
from validate.execution.engine import CAMPAIGN, ExecutionContext
from validate.execution.fork_server import WORTH, ForkServer, modules_for, terminal_blocked
from validate.execution.process import ForkServerError, interrupts_wait, shared_watchdog, usable_cores
from validate.execution.worker import Job, Worker
from validate.store.disk import disk_error, write_durably
from validate.store.store import LOG, RECORD, REQUEST, Store
from validate.tasks.run import ChildExit

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import ProvenanceRecord, RunRecord

# How long a scheduler may take to answer [s].
_CONNECT = 10.0


def quieten() -> None:
    """From now on Dask says nothing on stderr: what a user should know, sentences and records say."""
    import distributed  # noqa: F401 # pyright: ignore[reportMissingImports] - it sets up its loggers

    for name in ("asyncio", "tornado.application", *filter(lambda name: name.startswith("distributed"), logging.root.manager.loggerDict)):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def remote_cluster(where: str) -> Iterator[Any]:
    """A client of the cluster at an address, or of a scheduler file. Raises MachineError where none answers."""
    from distributed import Client  # pyright: ignore[reportMissingImports]

    try:
        address = json.loads(Path(where).read_text(encoding="utf-8"))["address"] if where.endswith(".json") else where
        asyncio.run(_ask(address))  # beforehand: a Client that finds nobody leaves a thread and its words behind
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except Exception as error:  # what Dask raises for a wrong address, or for somebody else who answers, is of any type
        why = next(iter(str(error).splitlines()), "") or "nothing is said there"
        raise MachineError(f"--engine dask:{where}: no Dask scheduler answers there ({why}); start one, or correct the address.") from error
    with client:
        yield client


async def _ask(address: str) -> None:
    """Raises where nobody at the address speaks as Dask does."""
    from distributed import Security  # pyright: ignore[reportMissingImports]
    from distributed.comm.core import connect  # pyright: ignore[reportMissingImports]

    asked = connect(address, timeout=_CONNECT, **Security().get_connection_args("client"))
    comm = await asyncio.wait_for(asked, 2 * _CONNECT)  # Dask itself waits for ever for one who takes a connection and says nothing
    await comm.close()


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """A client of a cluster of worker processes on this machine; its files are removed even if we are killed. Raises MachineError."""
    import dask.config as dask_config  # pyright: ignore[reportMissingImports]
    from distributed import Client, LocalCluster  # pyright: ignore[reportMissingImports]

    with contextlib.ExitStack() as open_now:
        try:
            folder = Path(tempfile.mkdtemp(prefix=".partial-dask-"))
            open_now.callback(shutil.rmtree, folder, ignore_errors=True)
            shared_watchdog().tell("start", uuid.uuid4().hex, str(folder))
            # Else the scheduler's own files lie in the folder for temporary files of everybody, and stay there.
            with dask_config.set({"temporary-directory": str(folder)}), terminal_blocked():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,  # that of the cells is not the workers'
                    dashboard_address=cast("str", None),  # none at all; its annotation forgot that
                    silence_logs=logging.CRITICAL,  # what they say, records say
                    local_directory=str(folder),
                )
            open_now.enter_context(cluster)
            client = open_now.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError) as error:
            why = next(iter(str(error).splitlines()), "") or type(error).__name__
            raise MachineError(
                f"--engine dask: its workers cannot be started here ({why}); make room for them, or let --engine local run the cells."
            ) from error
        yield client


# How long a folder that another machine has just made may be invisible: file systems over a network remember for so long what was not there [s].
_PATIENCE = 5.0
# Pause between two looks at a folder [s].
_LOOK = 0.05
_OF_THREAD = threading.local()


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a worker is asked to do. folder: the campaign's; mark: the name of the folder in it by which the worker sees that it has the same one before
    it; token: the campaign's; fingerprint: of its sources; cells: how many will come to one thread, which may be worth a fork server; name: by which the
    campaign counts how often the cell was begun."""

    cell: Job
    provenance: ProvenanceRecord
    folder: Path
    mark: str
    token: str
    fingerprint: str
    cells: int
    name: str


def run_on_worker(request: Request) -> RunRecord | ExaminationRecord | None:
    """Run one cell to its end; None if the campaign wanted it no longer. Raises MachineError."""
    wanted = _wanted()
    try:
        _check(request)
        _begin(request)
        provenance = _here(request.provenance)
        lost, server = _lost(request.cell, provenance), _server(request.cells)
        return Worker(request.cell, lost, provenance, Store(request.folder), server, token_begins=request.token).run(wanted)
    except MachineError as error:
        raise MachineError(f"{error} (said by the Dask worker on {socket.gethostname()}, process {os.getpid()})") from None


def _server(cells: int) -> ForkServer | None:
    """The process that forks the cells of this thread, with which it ends; None where there can be none."""
    if cells < WORTH:
        return None
    if not hasattr(_OF_THREAD, "server"):
        try:
            _OF_THREAD.server = ForkServer(modules_for(cells))
        except ForkServerError:
            _OF_THREAD.server = None
    return _OF_THREAD.server


def _wanted() -> Callable[[], bool]:
    """Whether somebody still waits for this task: Dask cannot stop a running one, it only marks it."""
    from distributed import Status, get_worker  # pyright: ignore[reportMissingImports]

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        ends = worker.status in {Status.closing, Status.closed, Status.failed}  # its scheduler is gone, or has dismissed it
        return not ends and task is not None and task.state in {"executing", "long-running", "resumed"}

    return wanted


def _check(request: Request) -> None:
    """That the campaign's folder and sources are what they are where the campaign is. Raises MachineError."""
    from validate.store.provenance import fingerprint

    until = time.monotonic() + _PATIENCE
    while not (Store(request.folder).runs / request.mark).is_dir():
        if time.monotonic() > until:
            raise MachineError(
                f"the campaign's folder {request.folder} is not seen here: a campaign and its Dask workers need a file system that they "
                "share; choose with --out a folder that lies at the same path on all of them."
            )
        time.sleep(_LOOK)
    if fingerprint() != request.fingerprint:
        raise MachineError(
            "the sources, libraries or compiler here are not those of the campaign, so that its records would lie; start the workers anew, from "
            "the same environment as the campaign."
        )


def _begin(request: Request) -> None:
    """Leave a sign that the cell was begun once more. Raises MachineError."""
    sign = Store(request.folder).runs / request.mark / f"{request.name}-{uuid.uuid4().hex}"
    try:
        sign.touch()
    except OSError as error:
        raise disk_error(request.folder, error) from error


def _here(provenance: ProvenanceRecord) -> ProvenanceRecord:
    """The campaign's provenance with the machine that this is."""
    from validate.store.provenance import machine

    return provenance.model_copy(update=machine())


def _lost(job: Job, provenance: ProvenanceRecord) -> Callable[[ChildExit, Path], RunRecord | ExaminationRecord]:
    """Makes the record of a child that left none."""
    from models.catalog import load_scene
    from validate.tasks.examination import Examination, lost_examination
    from validate.tasks.leg import planned_stages
    from validate.tasks.path import lost_run
    from validate.tasks.plugins import load_tools
    from validate.tasks.run import RunTask
    from validate.tasks.variant import varied

    def record(lost: ChildExit, folder: Path) -> RunRecord | ExaminationRecord:
        if isinstance(job, Examination):
            return lost_examination(job, provenance, lost)
        assert isinstance(job, RunTask)
        tools, scene = load_tools(job.tools), load_scene(job.scene)
        if job.variant is not None:
            scene = varied(scene, job.variant)
        plan = planned_stages(job.pipeline, {leg.method: tools.load_method(leg.method) for leg in job.pipeline.legs})
        return lost_run(job, scene, plan, provenance, lost, folder)

    return record


# How long workers may take to tidy up [s].
_TIDY = 10.0
# How often a cell is given anew to workers that are lost before they begin it.
_GIVEN_ANEW = 5
_GONE = "the Dask scheduler is gone; what finished is stored, and the same command goes on from there."


@contextmanager
def open_dask(where: str, jobs: int | None, site: ExecutionContext, cells: int) -> Iterator[DaskEngine]:
    """The engine of a cluster. where: address or scheduler file, "" for worker processes here; jobs: that many of them (None: one a core), or cells at a time;
    cells: how many there are.

    Raises MachineError where there is no cluster.
    """
    quieten()
    with contextlib.ExitStack() as open_now:
        mark = site.store.open_partial(CAMPAIGN, site.token + uuid.uuid4().hex[:16]).resolve()
        open_now.callback(shutil.rmtree, mark, ignore_errors=True)
        shared_watchdog().tell("start", uuid.uuid4().hex, str(mark))
        client = open_now.enter_context(remote_cluster(where) if where else local_cluster(jobs or usable_cores()))
        engine = DaskEngine(client, site, jobs if where else None, mark, cells)
        try:
            yield engine
        finally:
            with interrupts_wait():
                engine.close()


@contextmanager
def _gone_in_words() -> Iterator[None]:
    """What Dask raises where its scheduler cannot be reached, as a MachineError. Raises it."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # no connection, or a client that has given up
        raise MachineError(_GONE) from error


@dataclass
class _Tries:
    """Of a cell that Dask has: what its beginnings are counted by, how often Dask gave it up, and since when."""

    name: str = field(default_factory=lambda: uuid.uuid4().hex)
    lost: int = 0
    since: float = field(default_factory=time.monotonic)


class DaskEngine:
    """See the module docstring. jobs: at most so many cells are given to Dask at a time, None: all, since a cluster grows by what waits for it; mark: the
    folder by which a worker sees that it has the campaign's folder before it; cells: how many there are."""

    def __init__(self, client: Any, site: ExecutionContext, jobs: int | None, mark: Path, cells: int) -> None:
        from validate.store.provenance import fingerprint

        self._client, self._site, self.jobs, self._mark = client, site, jobs, mark
        self._executor = client.get_executor(pure=False)
        self._fingerprint, self._cells = fingerprint(), cells // max(1, self._threads())
        self._tries: dict[str, _Tries] = {}

    def submit(self, cell: Job) -> Future[RunRecord | ExaminationRecord | None]:
        request = Request(
            cell=cell,
            provenance=self._site.provenance,
            folder=self._site.store.folder.resolve(),
            mark=self._mark.name,
            token=self._site.token,
            fingerprint=self._fingerprint,
            cells=self._cells,
            name=self._tries.setdefault(cell.key, _Tries()).name,
        )
        with _gone_in_words():
            return self._executor.submit(run_on_worker, request)

    def result(self, cell: Job, future: Future[RunRecord | ExaminationRecord | None]) -> RunRecord | ExaminationRecord | None:
        record = self._result(cell, future)
        if record is not None:
            del self._tries[cell.key]
        return record

    def _result(self, cell: Job, future: Future[RunRecord | ExaminationRecord | None]) -> RunRecord | ExaminationRecord | None:
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]

        tries = self._tries[cell.key]
        try:
            if (record := future.result()) is not None:
                return record
        except CancelledError as error:
            raise MachineError(_GONE) from error
        except KilledWorker as error:
            begun = len(list(self._mark.glob(f"{tries.name}*")))
            if begun > error.allowed_failures:
                return self._crashed(cell, tries, f"{begun} workers of the Dask cluster were lost while they ran it.")
        except MachineError:
            raise
        except Exception as error:  # of any type: what a worker with other packages raises while it reads the cell
            told = (str(error).splitlines() or [""])[0]
            raise MachineError(
                f"a Dask worker could not run {cell.title} ({type(error).__name__}: {told}); "
                "install the same touchstone-contact where the workers run."
            ) from error
        tries.lost += 1  # before it was begun, or with a worker that took itself for dismissed
        if tries.lost > _GIVEN_ANEW:
            raise MachineError(f"workers of the Dask cluster are lost before they begin {cell.title}; their logs say why.")
        return None

    def _crashed(self, cell: Job, tries: _Tries, message: str) -> RunRecord | ExaminationRecord:
        """The record of a cell that took its workers with it, stored."""
        site = self._site
        wall = time.monotonic() - tries.since
        folder = site.store.open_partial(cell.key, site.token + uuid.uuid4().hex[:16])
        record = site.lost(cell)(ChildExit(outcome="crashed", message=message, wall=wall, cpu=0.0, log=""), folder)
        request = {"cell": cell.to_json(), "provenance": site.provenance.model_dump(mode="json")}
        write_durably(folder / REQUEST, json.dumps(request, indent=1))
        write_durably(folder / LOG, "")
        write_durably(folder / RECORD, record.model_dump_json(indent=1))
        site.store.commit(folder, record.key)
        return record

    def why_idle(self, submitted: int) -> str:
        if self._threads():
            return ""
        return f"the Dask cluster at {self._client.scheduler.address} has no workers yet; {submitted} cells wait for one"

    def _threads(self) -> int:
        """How many cells the workers of the cluster can run at a time."""
        with _gone_in_words():
            return sum(self._client.nthreads().values())

    def close(self) -> None:
        """Have what runs ended, wait until workers have left nothing of it, then remove what those left that are gone."""
        self._executor.shutdown(wait=False)
        until = time.monotonic() + _TIDY
        while self._site.unfinished() and time.monotonic() < until:
            time.sleep(_LOOK)
        for folder in self._site.unfinished():
            shutil.rmtree(folder, ignore_errors=True)
