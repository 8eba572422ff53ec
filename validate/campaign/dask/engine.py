"""Run tasks on the workers of a Dask cluster: local processes, or an existing cluster.

    # two local worker processes, which end with the campaign
    with open_dask("", 2, context, 100) as engine: ...
    # or the path of a scheduler file, FILE.json
    with open_dask("tcp://10.0.0.1:8786", None, context, 100) as engine: ...

Each Dask task watches a child process that writes into the folder of the campaign, so that
campaign and workers need a shared file system. A record's key depends on sources, libraries and
compiler. A worker with another folder, or with another of these, raises MachineError.
"""

from __future__ import annotations

import contextlib
import importlib.util
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
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from models.errors import MachineError
from models.results.run import ProvenanceRecord
from models.results.stored import to_json
from validate.campaign.engine import (
    CAMPAIGN,
    EngineError,
    EngineKind,
    ExecutionContext,
    preloaded_for,
)
from validate.processes.disk import refusals_in_words, write_durably
from validate.processes.process import KeptFolder, interrupts_wait, usable_cores
from validate.store.provenance import fingerprint, machine
from validate.store.store import LOG, RECORD, Store
from validate.tasks.task import ChildExit, Task, TaskRecord
from validate.tasks.worker import Worker, record_for_crash, write_request

# Longest wait for a scheduler's answer [s].
_CONNECT = 10.0


def quieten() -> None:
    """Silence Dask on stderr; errors and records inform the user instead."""
    import distributed  # noqa: F401 # pyright: ignore[reportMissingImports] - the import sets up the loggers

    for name in (
        "asyncio",
        "tornado.application",
        *filter(lambda name: name.startswith("distributed"), logging.root.manager.loggerDict),
    ):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def remote_cluster(where: str) -> Iterator[Any]:
    """Open a client of the cluster at an address, or of a scheduler file.

    Raises MachineError if no scheduler answers.
    """
    import asyncio  # takes 0.05 s; campaigns without Dask import this module too

    from distributed import Client  # pyright: ignore[reportMissingImports]

    try:
        address = (
            json.loads(Path(where).read_text(encoding="utf-8"))["address"]
            if where.endswith(".json")
            else where
        )
        # A Client without a scheduler leaves a thread with its messages behind.
        asyncio.run(_ask(address))
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except Exception as error:  # Dask raises any type for a wrong address or another server
        why = next(iter(str(error).splitlines()), "") or "nothing is said there"
        raise MachineError(
            f"--engine dask:{where}: no Dask scheduler answers there ({why}); start one, or correct the address."
        ) from error
    with client:
        yield client


async def _ask(address: str) -> None:
    """Raise an exception if no Dask scheduler answers at the address."""
    import asyncio

    from distributed import Security  # pyright: ignore[reportMissingImports]
    from distributed.comm.core import connect  # pyright: ignore[reportMissingImports]

    asked = connect(address, timeout=_CONNECT, **Security().get_connection_args("client"))
    # Dask waits without limit for a server that accepts the connection and sends nothing.
    comm = await asyncio.wait_for(asked, 2 * _CONNECT)
    await comm.close()


@contextmanager
def _terminal_blocked() -> Iterator[None]:
    """Block Ctrl-C and SIGHUP in threads and processes started meanwhile.

    Their descendants inherit the mask. Only the campaign's process handles these signals.
    """
    # A later start of the resource tracker would lift the mask.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """Open a client of a cluster of worker processes on this machine.

    The cluster's files are removed even if this process is killed. Raises MachineError.
    """
    import dask.config as dask_config  # pyright: ignore[reportMissingImports]
    from distributed import Client, LocalCluster  # pyright: ignore[reportMissingImports]

    with contextlib.ExitStack() as open_now:
        try:
            folder = Path(tempfile.mkdtemp(prefix=".partial-dask-"))
            open_now.enter_context(closing(KeptFolder(folder)))
            # By default the scheduler's files stay in the shared folder for temporary files. The
            # default timeout drops a worker and its nanny if a restart takes more than 15 s;
            # Dask never replaces them.
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
                    memory_limit=0,  # the workers' memory excludes that of the tasks
                    dashboard_address=cast("str", None),  # no dashboard; the annotation lacks None
                    silence_logs=logging.CRITICAL,  # records contain the failures
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


# Longest time until a new folder of another machine is visible [s]; network file systems cache
# missing names.
_PATIENCE = 5.0
# Pause between two checks of a folder [s].
_LOOK = 0.05
# `preloaded`: the process from which the tasks of this thread fork, one after the other. The
# process ends with the thread.
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
    """Run one task to its end; return None if the campaign no longer needs the task.

    - name: identifies the starts of the task
    - folder, token: of the campaign
    - mark: name of a folder in the campaign's folder, which the worker must see
    - sources: fingerprint of the campaign's sources
    - tasks: number of tasks for each thread

    Raises MachineError.
    """
    wanted, store = _wanted(), Store(folder)
    try:
        _check(store, mark, sources)
        with refusals_in_words(folder):
            # Count this start of the task.
            (store.runs / mark / f"{name}-{uuid.uuid4().hex}").touch()
        if getattr(_OF_THREAD, "preloaded", None) is None:  # first task, or not worth it before
            _OF_THREAD.preloaded = preloaded_for(tasks)
        here = replace(provenance, **machine())
        return Worker(task, here, store, preloaded=_OF_THREAD.preloaded, token_begins=token).run(
            wanted
        )
    except MachineError as error:
        raise MachineError(
            f"{error} (said by the Dask worker on {socket.gethostname()}, process {os.getpid()})"
        ) from None


def _wanted() -> Callable[[], bool]:
    """Return a check whether the task is still needed; Dask only marks running tasks."""
    from distributed import Status, get_worker  # pyright: ignore[reportMissingImports]

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        ends = worker.status in {
            Status.closing,
            Status.closed,
            Status.failed,
        }  # the scheduler is gone or has dismissed the worker
        return (
            not ends and task is not None and task.state in {"executing", "long-running", "resumed"}
        )

    return wanted


def _check(store: Store, mark: str, sources: str) -> None:
    """Raise MachineError if folder or sources differ from those of the campaign."""
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


# Longest wait for the workers' cleanup [s].
_TIDY = 10.0
# Largest number of resubmissions of a task whose workers are lost before its start.
_GIVEN_ANEW = 5
_GONE = (
    "the Dask scheduler is gone; what finished is stored, and the same command goes on from there."
)


@contextmanager
def open_dask(
    where: str, jobs: int | None, context: ExecutionContext, tasks: int
) -> Iterator[DaskEngine]:
    """Open the engine of a cluster.

    where: address or scheduler file, "" for local worker processes.
    jobs: number of local worker processes (None: one for each core), or tasks at a time.
    tasks: number of tasks.

    Raises MachineError if there is no cluster.
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
    """Raise MachineError instead of Dask's exceptions if its scheduler is unreachable."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # no connection, or a closed client
        raise MachineError(_GONE) from error


@dataclass
class _Tries:
    """Dask's attempts at a task.

    name: identifies its starts. given_up: attempts that Dask gave up. since: time of the first.
    """

    name: str = field(default_factory=lambda: uuid.uuid4().hex)
    given_up: int = 0
    since: float = field(default_factory=time.monotonic)


class DaskEngine:
    """Run tasks on a Dask cluster.

    jobs: largest number of submitted tasks, None for all, since a cluster grows with waiting tasks.
    mark: folder by which a worker recognises the campaign's folder.
    tasks: number of tasks.

    Dask's scheduler repeats a task whose worker is lost, `allowed-failures` times (3); then the task
    has crashed. The scheduler also counts lost workers on which a task only waited. A task with fewer
    starts is submitted again. Folders of lost workers are removed at the end of the campaign.
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
        # A worker with other packages raises any type while it reads the task.
        except Exception as error:
            why = (str(error).splitlines() or [""])[0]
            raise MachineError(
                f"a Dask worker could not run {task.title} ({type(error).__name__}: {why}); "
                "install the same touchstone-contact where the workers run."
            ) from error
        if record is not None:
            del self._tries[task.key]
            return record
        tries.given_up += 1  # before its start, or by a dismissed worker
        if tries.given_up > _GIVEN_ANEW:
            raise MachineError(
                f"workers of the Dask cluster are lost before they begin {task.title}; their logs say why."
            )
        return None

    def _crashed(self, task: Task, tries: _Tries, message: str) -> TaskRecord:
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
        write_durably(folder / RECORD, to_json(record))
        context.store.commit(folder, record.key)
        return record

    def why_idle(self, submitted: int) -> str:
        """See LocalEngine.

        Raises MachineError if all local workers have ended and cannot be restarted.
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
        with _gone_in_words():
            return sum(self._client.nthreads().values())

    def close(self) -> None:
        """Stop running tasks, wait for the workers' cleanup, then remove remaining folders."""
        self._executor.shutdown(wait=False)
        until = time.monotonic() + _TIDY
        while self._context.unfinished() and time.monotonic() < until:
            time.sleep(_LOOK)
        for folder in self._context.unfinished():
            shutil.rmtree(folder, ignore_errors=True)


def check_place(place: str) -> None:
    """Raise MachineError without the package of Dask, EngineError for a bad scheduler file.

    place: address or scheduler file, "" for local worker processes.
    """
    if importlib.util.find_spec("distributed") is None:
        raise MachineError(
            f"--engine dask{place and ':'}{place} needs the package distributed: pip install distributed."
        )
    if place.endswith(".json"):
        _check_scheduler_file(Path(place))


def _check_scheduler_file(path: Path) -> None:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (
        OSError,
        ValueError,
        RecursionError,
    ) as error:  # missing, no JSON, or nested too deeply
        why = error.strerror if isinstance(error, OSError) else "it is no JSON"
        raise EngineError(
            f"--engine dask:{path}: the scheduler file cannot be read ({why}); start a scheduler that writes it."
        ) from error
    if not isinstance(content, dict) or not isinstance(content.get("address"), str):
        raise EngineError(
            f"--engine dask:{path}: this is no scheduler file of Dask (it has no `address`); give the one the scheduler wrote."
        )


DASK_KIND = EngineKind(
    forms=("dask", "dask:ADDRESS", "dask:FILE.json"), check=check_place, open=open_dask
)
