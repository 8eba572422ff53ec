"""The engine that runs tasks on the workers of a Dask cluster: one of this machine's processes, or one that stands somewhere.

    # two worker processes here, which end with the campaign
    with open_dask("", 2, context, 100) as engine: ...
    # or the path of a scheduler file, FILE.json
    with open_dask("tcp://10.0.0.1:8786", None, context, 100) as engine: ...

A task whose worker is lost is run again by Dask's scheduler, as often as its `allowed-failures`
says (3 times); then it has crashed. The scheduler also counts against a task that it only waited on
a worker that was lost: one that was begun less often is given to it anew. What is left of a worker
that went without a trace is removed when the campaign ends.

A task runs on a worker as it does here: in a child process, watched by the thread of the Dask task,
into the folder of the campaign, which is reached by its path: campaign and workers share a file
system. A worker that sees another folder there, or that has other sources, libraries or another
compiler than the campaign, says so and runs nothing, since a record is filed under a key that all
of them decide.
"""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing.resource_tracker
import os
import shutil
import signal
import socket
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

from models.errors import MachineError
from reports.records.record import ProvenanceRecord
from validate.campaign.engine import CAMPAIGN, ExecutionContext, preloaded_for
from validate.processes.disk import refusals_in_words, write_durably
from validate.processes.process import KeptFolder, interrupts_wait, usable_cores
from validate.store.provenance import fingerprint, machine
from validate.store.store import LOG, RECORD, Store
from validate.tasks.task import ChildExit, Task, TaskRecord
from validate.tasks.worker import Worker, record_for_crash, write_request

# How long a scheduler may take to answer [s].
_CONNECT = 10.0


def quieten() -> None:
    """From now on Dask says nothing on stderr: what a user should know, sentences and records say."""
    import distributed  # noqa: F401 # pyright: ignore[reportMissingImports] - it sets up its loggers

    for name in (
        "asyncio",
        "tornado.application",
        *filter(lambda name: name.startswith("distributed"), logging.root.manager.loggerDict),
    ):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def remote_cluster(where: str) -> Iterator[Any]:
    """A client of the cluster at an address, or of a scheduler file.

    Raises MachineError where none answers.
    """
    import asyncio  # 0.05 s: not for campaigns without Dask, whose process imports this file too

    from distributed import Client  # pyright: ignore[reportMissingImports]

    try:
        address = (
            json.loads(Path(where).read_text(encoding="utf-8"))["address"]
            if where.endswith(".json")
            else where
        )
        asyncio.run(
            _ask(address)
        )  # beforehand: a Client that finds nobody leaves a thread and its words behind
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except Exception as error:  # what Dask raises for a wrong address, or for somebody else who answers, is of any type
        why = next(iter(str(error).splitlines()), "") or "nothing is said there"
        raise MachineError(
            f"--engine dask:{where}: no Dask scheduler answers there ({why}); start one, or correct the address."
        ) from error
    with client:
        yield client


async def _ask(address: str) -> None:
    """Raises where nobody at the address speaks as Dask does."""
    import asyncio

    from distributed import Security  # pyright: ignore[reportMissingImports]
    from distributed.comm.core import connect  # pyright: ignore[reportMissingImports]

    asked = connect(address, timeout=_CONNECT, **Security().get_connection_args("client"))
    comm = await asyncio.wait_for(
        asked, 2 * _CONNECT
    )  # Dask itself waits for ever for one who takes a connection and says nothing
    await comm.close()


@contextmanager
def _terminal_blocked() -> Iterator[None]:
    """Threads and processes started meanwhile, and what these ever start, do not hear Ctrl-C and a closed terminal: those are for us."""
    # it would lift the mask when it is started later
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """A client of a cluster of worker processes on this machine.

    Its files are removed even if we are killed. Raises MachineError.
    """
    import dask.config as dask_config  # pyright: ignore[reportMissingImports]
    from distributed import Client, LocalCluster  # pyright: ignore[reportMissingImports]

    with contextlib.ExitStack() as open_now:
        try:
            folder = Path(tempfile.mkdtemp(prefix=".partial-dask-"))
            open_now.enter_context(closing(KeptFolder(folder)))
            # Else the scheduler's own files lie in the folder for temporary files of everybody, and
            # stay there; and a worker that its nanny takes longer than 15 s to start anew is given
            # up by the cluster, nanny and all, for which nobody starts another.
            open_now.enter_context(
                dask_config.set(
                    {
                        "temporary-directory": str(folder),
                        "distributed.deploy.lost-worker-timeout": "1000 days",
                    }
                )
            )
            with _terminal_blocked():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,  # that of the tasks is not the workers'
                    dashboard_address=cast("str", None),  # none at all; its annotation forgot that
                    silence_logs=logging.CRITICAL,  # what they say, records say
                    local_directory=str(folder),
                )
            open_now.enter_context(cluster)
            client = open_now.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError) as error:
            why = next(iter(str(error).splitlines()), "") or type(error).__name__
            raise MachineError(
                f"--engine dask: its workers cannot be started here ({why}); make room for them, or let --engine local run the tasks."
            ) from error
        yield client


# How long a folder that another machine has just made may be invisible: file systems over a network
# remember for so long what was not there [s].
_PATIENCE = 5.0
# Pause between two looks at a folder [s].
_LOOK = 0.05
# `preloaded`: what the tasks of this thread are forked from; it ends with the thread, and a thread
# of a Dask worker runs one task after the other.
_OF_THREAD = threading.local()


def run_on_worker(
    task: Task,
    name: str,
    *,
    folder: Path,
    mark: str,
    token: str,
    provenance: ProvenanceRecord,
    sources: str,
    tasks: int,
) -> TaskRecord | None:
    """Run one task to its end; None if the campaign wanted it no longer. Raises MachineError.

    name: by which the campaign counts how often the task was begun; folder: the campaign's; mark:
        the name of the folder in it by which the worker sees that
    it has the same one before it; token: the campaign's; sources: their fingerprint there; tasks:
        how many will come to one thread.
    """
    wanted, store = _wanted(), Store(folder)
    try:
        _check(store, mark, sources)
        with refusals_in_words(folder):
            (
                store.runs / mark / f"{name}-{uuid.uuid4().hex}"
            ).touch()  # the task was begun once more
        if getattr(_OF_THREAD, "preloaded", None) is None:  # nor was it worth it until now
            _OF_THREAD.preloaded = preloaded_for(tasks)
        here = provenance.model_copy(update=machine())
        return Worker(task, here, store, preloaded=_OF_THREAD.preloaded, token_begins=token).run(
            wanted
        )
    except MachineError as error:
        raise MachineError(
            f"{error} (said by the Dask worker on {socket.gethostname()}, process {os.getpid()})"
        ) from None


def _wanted() -> Callable[[], bool]:
    """Whether somebody still waits for this task: Dask cannot stop a running one, it only marks it."""
    from distributed import Status, get_worker  # pyright: ignore[reportMissingImports]

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        ends = worker.status in {
            Status.closing,
            Status.closed,
            Status.failed,
        }  # its scheduler is gone, or has dismissed it
        return (
            not ends and task is not None and task.state in {"executing", "long-running", "resumed"}
        )

    return wanted


def _check(store: Store, mark: str, sources: str) -> None:
    """That the campaign's folder and sources are what they are where the campaign is.

    Raises MachineError.
    """
    until = time.monotonic() + _PATIENCE
    while not (store.runs / mark).is_dir():
        if time.monotonic() > until:
            raise MachineError(
                f"the campaign's folder {store.folder} is not seen here: a campaign and its Dask workers need a file system that they "
                "share; choose with --out a folder that lies at the same path on all of them."
            )
        time.sleep(_LOOK)
    if fingerprint() != sources:
        raise MachineError(
            "the sources, libraries or compiler here are not those of the campaign, so that its records would lie; start the workers anew, from "
            "the same environment as the campaign."
        )


# How long workers may take to tidy up [s].
_TIDY = 10.0
# How often a task is given anew to workers that are lost before they begin it.
_GIVEN_ANEW = 5
_GONE = (
    "the Dask scheduler is gone; what finished is stored, and the same command goes on from there."
)


@contextmanager
def open_dask(
    where: str, jobs: int | None, context: ExecutionContext, tasks: int
) -> Iterator[DaskEngine]:
    """The engine of a cluster.

    where: address or scheduler file, "" for worker processes here; jobs: that many of them (None:
        one a core), or tasks at a time; tasks: how many there are.
    Raises MachineError where there is no cluster.
    """
    quieten()
    with contextlib.ExitStack() as open_now:
        mark = context.store.open_partial(CAMPAIGN, context.token).resolve()
        open_now.enter_context(closing(KeptFolder(mark)))
        client = open_now.enter_context(
            remote_cluster(where) if where else local_cluster(jobs or usable_cores())
        )
        engine = DaskEngine(client, context, jobs if where else None, mark, tasks)
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
    """Of a task that Dask has: what its beginnings are counted by, how often Dask gave it up, and since when."""

    name: str = field(default_factory=lambda: uuid.uuid4().hex)
    given_up: int = 0
    since: float = field(default_factory=time.monotonic)


class DaskEngine:
    """See the module docstring.

    jobs: at most so many tasks are given to Dask at a time, None: all, since a cluster grows by
        what waits for it; mark: the
    folder by which a worker sees that it has the campaign's folder before it; tasks: how many there
        are.
    """

    def __init__(
        self, client: Any, context: ExecutionContext, jobs: int | None, mark: Path, tasks: int
    ) -> None:
        self._client, self._context, self.jobs, self._mark = client, context, jobs, mark
        self._executor = client.get_executor(pure=False)
        self._run = partial(
            run_on_worker,
            folder=context.store.folder.resolve(),
            mark=mark.name,
            token=context.token,
            provenance=context.provenance,
            sources=fingerprint(),
            tasks=tasks // max(1, self._threads()),
        )
        self._tries: dict[str, _Tries] = {}

    def submit(self, task: Task) -> Future[TaskRecord | None]:
        """See LocalEngine."""
        with _gone_in_words():
            return self._executor.submit(
                self._run, task, self._tries.setdefault(task.key, _Tries()).name
            )

    def result(self, task: Task, future: Future[TaskRecord | None]) -> TaskRecord | None:
        """See LocalEngine."""
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]

        tries, record = self._tries[task.key], None
        try:
            record = future.result()
        except CancelledError as error:
            raise MachineError(_GONE) from error
        except KilledWorker as error:
            begun = len(list(self._mark.glob(f"{tries.name}*")))
            if begun > error.allowed_failures:
                record = self._crashed(
                    task, tries, f"{begun} workers of the Dask cluster were lost while they ran it."
                )
        except MachineError:
            raise
        except (
            Exception
        ) as error:  # of any type: what a worker with other packages raises while it reads the task
            why = (str(error).splitlines() or [""])[0]
            raise MachineError(
                f"a Dask worker could not run {task.title} ({type(error).__name__}: {why}); "
                "install the same touchstone-contact where the workers run."
            ) from error
        if record is not None:
            del self._tries[task.key]
            return record
        tries.given_up += 1  # before it was begun, or with a worker that took itself for dismissed
        if tries.given_up > _GIVEN_ANEW:
            raise MachineError(
                f"workers of the Dask cluster are lost before they begin {task.title}; their logs say why."
            )
        return None

    def _crashed(self, task: Task, tries: _Tries, message: str) -> TaskRecord:
        """The record of a task that took its workers with it, stored."""
        context = self._context
        folder = context.store.open_partial(task.key, context.token)
        child = ChildExit(
            outcome="crashed", message=message, wall=time.monotonic() - tries.since, cpu=0.0, log=""
        )
        record = record_for_crash(
            task, context.provenance, child, folder, context.loaded.get(task.key)
        )
        write_request(folder, task, context.provenance)
        write_durably(folder / LOG, "")
        write_durably(folder / RECORD, record.model_dump_json())
        context.store.commit(folder, record.key)
        return record

    def why_idle(self, submitted: int) -> str:
        """See LocalEngine.

        Raises MachineError where no worker can come any more: those of this machine, when none
        could be started anew.
        """
        from distributed import Status  # pyright: ignore[reportMissingImports]

        if self._threads():
            return ""
        here = self._client.cluster
        if here is not None and all(
            nanny.status in {Status.closed, Status.failed} for nanny in here.workers.values()
        ):
            raise MachineError(
                f"--engine dask: its workers ended and could not be started anew; {submitted} tasks wait. What finished is stored: give the same "
                "command when the machine has room, or let --engine local run the tasks."
            )
        return f"the Dask cluster at {self._client.scheduler.address} has no workers now; {submitted} tasks wait for one"

    def _threads(self) -> int:
        """How many tasks the workers of the cluster can run at a time."""
        with _gone_in_words():
            return sum(self._client.nthreads().values())

    def close(self) -> None:
        """Have what runs ended, wait until workers have left nothing of it, then remove what those left that are gone."""
        self._executor.shutdown(wait=False)
        until = time.monotonic() + _TIDY
        while self._context.unfinished() and time.monotonic() < until:
            time.sleep(_LOOK)
        for folder in self._context.unfinished():
            shutil.rmtree(folder, ignore_errors=True)
