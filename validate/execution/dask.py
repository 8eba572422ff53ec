"""The engine that runs cells on the workers of a Dask cluster: one of this machine's processes, or one that stands somewhere.

    with open_dask("", 2, site) as engine: ...                      # two worker processes here, which end with the campaign
    with open_dask("tcp://10.0.0.1:8786", None, site) as engine: ...      # or the path of a scheduler file, FILE.json

A cell whose worker is lost is run again by Dask's scheduler, as often as its `allowed-failures` says (3 times); then it has crashed. The scheduler also
counts against a cell that it only waited on a worker that was lost: one that was begun less often is given to it anew. What is left of a
worker that went without a trace is removed when the campaign ends.

The Dask cluster that a campaign runs on, as a client of it: one that stands somewhere, or worker processes of this machine.

quieten()
with remote_cluster("tcp://10.0.0.1:8786") as client: ...       # or the path of a scheduler file, FILE.json
with local_cluster(2, watchdog) as client: ...                  # two worker processes, which end with it

A cell on a worker of a Dask cluster: the same child process, watched by the thread of the Dask task, into the folder of the campaign.

    answer = run_on_worker(request)     # {"record": JSON}, {"machine": sentence}, or {} if the campaign wanted it no longer

The folder is reached by its path: campaign and workers share a file system. A worker that sees another folder there, or that has other sources,
libraries or another compiler than the campaign, says so and runs nothing, since a record is filed under a key that all of them decide.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
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
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from models.errors import MachineError
from validate.execution.engine import Site
from validate.execution.fork_server import terminal_blocked
from validate.execution.process import Watchdog
from validate.store.disk import disk_error, write_durably
from validate.store.store import LOG, PROGRESS, RECORD, REQUEST, Store

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import ProvenanceRecord, RunRecord
    from validate.execution.fork_server import ForkServer
    from validate.execution.worker import Job, Lost

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
def local_cluster(workers: int, watchdog: Watchdog) -> Iterator[Any]:
    """A client of a cluster of worker processes on this machine; its files are removed even if we are killed. Raises MachineError."""
    import dask.config as dask_config  # pyright: ignore[reportMissingImports]
    from distributed import Client, LocalCluster  # pyright: ignore[reportMissingImports]

    with contextlib.ExitStack() as open_now:
        try:
            folder = Path(tempfile.mkdtemp(prefix=".partial-dask-"))
            open_now.callback(shutil.rmtree, folder, ignore_errors=True)
            watchdog.tell("start", uuid.uuid4().hex, str(folder))
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


# How often a child is looked at [s], as on the campaign's own machine.
_LOOK_AT_CHILD = 0.05
# How long a folder that another machine has just made may be invisible: file systems over a network remember for so long what was not there [s].
_PATIENCE = 5.0
_OF_THREAD = threading.local()


def job_from_json(data: Mapping[str, Any]) -> Job:
    """The cell or the examination of a request."""
    from validate.tasks.examination import Examination
    from validate.tasks.run import Cell

    return Examination.from_json(data) if "examination" in data else Cell.from_json(data)


def run_on_worker(request: Mapping[str, Any]) -> dict[str, str]:
    """Run one cell to its end. request: cell and provenance (JSON), folder, its mark, the campaign's token, fingerprint of its sources,
    cells: how many will come to one thread, which may be worth a fork server, name: by which the campaign counts how often the cell was begun."""
    from reports.records.record import ProvenanceRecord
    from validate.execution.process import shared_watchdog
    from validate.execution.worker import Worker

    wanted = _wanted()
    try:
        _check(request)
        _begin(request)
        job, provenance = job_from_json(request["cell"]), _here(ProvenanceRecord.model_validate(request["provenance"]))
        store, server = Store(Path(request["folder"])), _server(request["cells"])
        worker = Worker(job, _lost(job, provenance), provenance, store, shared_watchdog(), server, token_begins=request["token"])
        try:
            while wanted():
                time.sleep(_LOOK_AT_CHILD)
                record = worker.poll()
                if record is not None:
                    return {"record": record.model_dump_json()}
        except BaseException:
            worker.stop()
            raise
        worker.stop()
    except MachineError as error:
        return {"machine": f"{error} (said by {_name()})"}
    return {}


def _server(cells: int) -> ForkServer | None:
    """The process that forks the cells of this thread, with which it ends; None where there can be none."""
    from validate.execution.fork_server import WORTH, ForkServer, ForkServerError, modules_for

    if cells < WORTH:
        return None
    if not hasattr(_OF_THREAD, "server"):
        try:
            _OF_THREAD.server = ForkServer(modules_for(cells))
        except ForkServerError:
            _OF_THREAD.server = None
    return _OF_THREAD.server


def _name() -> str:
    return f"the Dask worker on {socket.gethostname()}, process {os.getpid()}"


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


def _check(request: Mapping[str, Any]) -> None:
    """That the campaign's folder and sources are what they are where the campaign is. Raises MachineError."""
    from validate.store.provenance import fingerprint

    runs, until = Store(Path(request["folder"])).runs, time.monotonic() + _PATIENCE
    while not (runs / request["mark"]).is_dir():
        if time.monotonic() > until:
            raise MachineError(
                f"the campaign's folder {request['folder']} is not seen here: a campaign and its Dask workers need a file system that they "
                "share; choose with --out a folder that lies at the same path on all of them."
            )
        time.sleep(_LOOK_AT_CHILD)
    if fingerprint() != request["fingerprint"]:
        raise MachineError(
            "the sources, libraries or compiler here are not those of the campaign, so that its records would lie; start the workers anew, from "
            "the same environment as the campaign."
        )


def _begin(request: Mapping[str, Any]) -> None:
    """Leave a sign that the cell was begun once more. Raises MachineError."""
    sign = Store(Path(request["folder"])).runs / request["mark"] / f"{request['name']}-{uuid.uuid4().hex}"
    try:
        sign.touch()
    except OSError as error:
        raise disk_error(Path(request["folder"]), error) from error


def _here(provenance: ProvenanceRecord) -> ProvenanceRecord:
    """The campaign's provenance with the machine that this is."""
    from validate.store.provenance import machine

    return provenance.model_copy(update=machine())


def _lost(job: Job, provenance: ProvenanceRecord) -> Callable[[Lost], RunRecord | ExaminationRecord]:
    """Makes the record of a child that left none."""
    from validate.tasks.examination import Examination, lost_examination
    from validate.tasks.run import Cell

    def record(lost: Lost) -> RunRecord | ExaminationRecord:
        if isinstance(job, Examination):
            return lost_examination(job, provenance, lost)
        assert isinstance(job, Cell)
        return _lost_cell(job, provenance, lost)

    return record


def _lost_cell(cell: Any, provenance: ProvenanceRecord, lost: Lost) -> RunRecord:
    from models.catalog import load_scene
    from validate.tasks.plugins import load_tools
    from validate.tasks.records import lost_run, planned_stages
    from validate.tasks.scene_record import scene_record
    from validate.tasks.variant import varied

    tools, scene = load_tools(cell.tools), load_scene(cell.scene)
    if cell.variant is not None:
        scene = varied(scene, cell.variant)
    plan = planned_stages(cell.pipeline, {leg.method: tools.load_method(leg.method) for leg in cell.pipeline.legs})
    return lost_run(cell, scene_record(scene), plan, provenance, lost)


# Pause between two looks at what is not a cell's end [s]; a cell that ends is seen at once.
_LOOK = 0.5
# How soon it is said that a cluster has no workers, and how long these may take to tidy up [s].
_NO_WORKERS, _TIDY = 5.0, 10.0
# How often a cell is given anew to workers that are lost before they begin it.
_GIVEN_ANEW = 5
_GONE = "the Dask scheduler is gone; what finished is stored, and the same command goes on from there."


@contextmanager
def open_dask(where: str, jobs: int | None, site: Site) -> Iterator[DaskEngine]:
    """The engine of a cluster. where: address or scheduler file, "" for worker processes here; jobs: that many of them, or cells at a time.

    Raises MachineError where there is no cluster.
    """
    quieten()
    token = uuid.uuid4().hex[:16]
    with contextlib.ExitStack() as open_now:
        watchdog = open_now.enter_context(Watchdog())
        mark = site.store.open_partial("campaign", token + uuid.uuid4().hex[:16]).resolve()
        open_now.callback(shutil.rmtree, mark, ignore_errors=True)
        watchdog.tell("start", uuid.uuid4().hex, str(mark))
        client = open_now.enter_context(remote_cluster(where) if where else local_cluster(jobs or 1, watchdog))
        yield DaskEngine(client, site, jobs if where else None, token, mark)


@contextmanager
def _gone_in_words() -> Iterator[None]:
    """What Dask raises where its scheduler cannot be reached, as a MachineError. Raises it."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # no connection, or a client that has given up
        raise MachineError(_GONE) from error


class _Submitted:
    """A cell that Dask has. begun: its unfinished folder, once there is one; name: what its beginnings are counted by; lost: how often Dask gave
    it up."""

    def __init__(self, cell: Job) -> None:
        self.cell, self.since = cell, time.monotonic()
        self.name, self.lost = uuid.uuid4().hex, 0
        self.begun: Path | None = None

    def progress(self) -> str:
        """Where the cell is, in words."""
        try:
            return (self.begun / PROGRESS).read_text(encoding="utf-8") if self.begun else "waiting for a worker"
        except OSError:
            return "its start"


class DaskEngine:
    """See the module docstring. jobs: at most so many cells are given to Dask at a time; token: what the unfinished folders of this
    campaign's cells are known by; mark: the folder by which a worker sees that it has the campaign's folder before it."""

    def __init__(self, client: Any, site: Site, jobs: int | None, token: str, mark: Path) -> None:
        from validate.store.provenance import fingerprint

        self._client, self._site, self._jobs, self._token = client, site, jobs, token
        self._store = Store(site.store.folder.resolve())
        self._request = {
            "provenance": site.provenance.model_dump(mode="json"),
            "folder": str(self._store.folder),
            "mark": mark.name,
            "token": token,
            "fingerprint": fingerprint(),
        }
        self._said = False

    def run(self, cells: Sequence[Job]) -> Generator[tuple[Job, RunRecord | ExaminationRecord], None, None]:
        waiting = list(cells)
        running: dict[concurrent.futures.Future[dict[str, str]], _Submitted] = {}
        executor = self._client.get_executor(pure=False)
        self._request["cells"] = len(cells) // max(1, self._threads())
        try:
            while waiting or running:
                self._submit(waiting, running, executor)
                self._look(tuple(running.values()))
                done, _ = concurrent.futures.wait(running, timeout=_LOOK, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    submitted = running[future]
                    record = self._record(submitted, future)
                    del running[future]
                    if record is None:
                        running[self._give(submitted, executor)] = submitted
                    elif self._site.again(record):
                        waiting.insert(0, submitted.cell)
                    else:
                        yield submitted.cell, record
        finally:
            for future in running:
                future.cancel()
            executor.shutdown(wait=False)
            self._tidy()

    def _submit(self, waiting: list[Job], running: dict[Any, _Submitted], executor: concurrent.futures.Executor) -> None:
        """Give Dask all that may run beside what it has: a cluster grows by what waits for it."""
        at_work = [submitted.cell for submitted in running.values()]
        for cell in tuple(waiting):
            if self._jobs is not None and len(at_work) >= self._jobs:
                return
            if not at_work or not self._site.must_wait(cell, at_work):
                waiting.remove(cell)
                submitted = _Submitted(cell)
                running[self._give(submitted, executor)] = submitted
                at_work.append(cell)

    def _give(self, submitted: _Submitted, executor: concurrent.futures.Executor) -> concurrent.futures.Future[dict[str, str]]:
        request = {**self._request, "cell": submitted.cell.to_json(), "name": submitted.name}
        with _gone_in_words():
            return executor.submit(run_on_worker, request)

    def _threads(self) -> int:
        """How many cells the workers of the cluster can run at a time."""
        with _gone_in_words():
            return sum(self._client.nthreads().values())

    def _look(self, submitted: Sequence[_Submitted]) -> None:
        folders = {path.name.split("-")[1]: path for path in self._unfinished()}
        for item in submitted:
            item.begun = folders.get(item.cell.key[:12])
        self._site.watch([item for item in submitted if item.begun])
        if folders:
            self._said = True
        elif not self._said and any(time.monotonic() - item.since > _NO_WORKERS for item in submitted):
            self._said = True
            if not self._threads():
                self._site.warn(
                    f"the Dask cluster at {self._client.scheduler.address} has no workers yet; {len(submitted)} cells wait for one"
                )

    def _unfinished(self) -> list[Path]:
        """Folders of this campaign's cells that are being written."""
        return [path for path in self._store.runs.glob(f".partial-*-{self._token}*") if path.name != self._request["mark"]]

    def _record(self, submitted: _Submitted, future: concurrent.futures.Future[dict[str, str]]) -> RunRecord | ExaminationRecord | None:
        """What came of a cell; None if it is to be given to Dask anew."""
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]

        from reports.records.check_record import StoredRecord

        try:
            answer = future.result()
        except concurrent.futures.CancelledError as error:
            raise MachineError(_GONE) from error
        except KilledWorker as error:
            begun = len(list((self._store.runs / self._request["mark"]).glob(f"{submitted.name}*")))
            if begun > error.allowed_failures:
                return self._crashed(submitted, f"{begun} workers of the Dask cluster were lost while they ran it.")
            answer = {}
        except Exception as error:  # of any type: what a worker with other packages raises while it reads the cell
            told = (str(error).splitlines() or [""])[0]
            raise MachineError(
                f"a Dask worker could not run {submitted.cell.title} ({type(error).__name__}: {told}); "
                "install the same touchstone-contact where the workers run."
            ) from error
        if "machine" in answer:
            raise MachineError(answer["machine"])
        if "record" in answer:
            return StoredRecord.model_validate_json(answer["record"]).root
        submitted.lost += 1  # before it was begun, or with a worker that took itself for dismissed
        if submitted.lost > _GIVEN_ANEW:
            raise MachineError(f"workers of the Dask cluster are lost before they begin {submitted.cell.title}; their logs say why.")
        return None

    def _crashed(self, submitted: _Submitted, message: str) -> RunRecord | ExaminationRecord:
        """The record of a cell that took its workers with it, stored."""
        from validate.execution.worker import Lost

        cell = submitted.cell
        wall = time.monotonic() - submitted.since
        record = self._site.lost(cell)(Lost(outcome="crashed", message=message, wall=wall, cpu=0.0, log=""))
        folder = self._store.open_partial(cell.key, self._token + uuid.uuid4().hex[:16])
        write_durably(folder / REQUEST, json.dumps({"cell": cell.to_json(), "provenance": self._request["provenance"]}, indent=1))
        write_durably(folder / LOG, "")
        write_durably(folder / RECORD, record.model_dump_json(indent=1))
        self._store.commit(folder, record.key)
        return record

    def _tidy(self) -> None:
        """Wait until workers have left nothing of what was stopped, then remove what those left that are gone."""
        until = time.monotonic() + _TIDY
        while self._unfinished() and time.monotonic() < until:
            time.sleep(0.05)
        for folder in self._unfinished():
            shutil.rmtree(folder, ignore_errors=True)
