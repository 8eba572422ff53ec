"""The Dask cluster that a campaign runs on, as a client of it: one that stands somewhere, or worker processes of this machine.

quieten()
with remote_cluster("tcp://10.0.0.1:8786") as client: ...       # or the path of a scheduler file, FILE.json
with local_cluster(2, watchdog) as client: ...                  # two worker processes, which end with it
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import multiprocessing.resource_tracker
import shutil
import signal
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from models.errors import MachineError
from validate.isolation.process import Watchdog

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
            with dask_config.set({"temporary-directory": str(folder)}), _terminal_blocked():
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


@contextmanager
def _terminal_blocked() -> Iterator[None]:
    """Threads started meanwhile, and the processes that these ever start, do not hear Ctrl-C and a closed terminal: those are for us."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    multiprocessing.resource_tracker.ensure_running()  # it would lift the mask when it is started later
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
