"""Where the tasks of a campaign run: executors of concurrent.futures, whose futures are records.

What runs when is the campaign's (validate.campaign.campaign).

    with open_local(2, context, len(tasks)) as engine:       # or validate.campaign.dask, open_dask
        future = engine.submit(task)
        record = engine.result(task, future)

Another engine is another class with `jobs`, `submit`, `result` and `why_idle`: it has a Worker run
where a task is to run, and a Worker stores what it finished by itself.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import sys
import threading
import uuid
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models.errors import MachineError, TouchstoneError
from reports.records.record import ProvenanceRecord
from validate.processes.disk import PARTIAL
from validate.processes.process import Preloaded, interrupts_wait, usable_cores
from validate.store.store import Store
from validate.tasks.path import LoadedRun
from validate.tasks.task import Task, TaskRecord
from validate.tasks.worker import Worker

LOCAL = "local"
DASK = "dask"
# In place of a key, in the name of an unfinished folder that is no task's but the campaign's
# (validate.campaign.dask).
CAMPAIGN = "campaign"


class EngineError(TouchstoneError):
    """No engine has this name, or its cluster is not described where the name says."""


@dataclass(frozen=True, kw_only=True)
class ExecutionContext:
    """What an engine has of a campaign.

    token: 16 letters and digits, by which the campaign knows its own unfinished folders; loaded:
        its runs, by
    key, as they are loaded here.
    """

    store: Store
    provenance: ProvenanceRecord
    token: str = field(default_factory=lambda: uuid.uuid4().hex[:16])
    loaded: Mapping[str, LoadedRun] = field(default_factory=dict)

    def unfinished(self) -> list[Path]:
        """Folders of the campaign's tasks that are being written."""
        return [
            path
            for path in self.store.runs.glob(f"{PARTIAL}*-{self.token}*")
            if not path.name.startswith(f"{PARTIAL}{CAMPAIGN}-")
        ]


def check_engine(name: str) -> None:
    """Raises EngineError if there is no such engine, MachineError if what it needs is not installed."""
    kind, colon, where = name.partition(":")
    if name == LOCAL:
        return
    if kind != DASK or (colon and not where):
        raise EngineError(
            f"--engine {name}: there is no such engine; the engines are local, dask, dask:ADDRESS and dask:FILE.json."
        )
    if importlib.util.find_spec("distributed") is None:
        raise MachineError(
            f"--engine {name} needs the package distributed: pip install distributed."
        )
    if where.endswith(".json"):
        _check_scheduler_file(Path(where))


def _check_scheduler_file(path: Path) -> None:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (
        OSError,
        ValueError,
        RecursionError,
    ) as error:  # not there, no JSON, or nested without end
        why = error.strerror if isinstance(error, OSError) else "it is no JSON"
        raise EngineError(
            f"--engine dask:{path}: the scheduler file cannot be read ({why}); start a scheduler that writes it."
        ) from error
    if not isinstance(content, dict) or not isinstance(content.get("address"), str):
        raise EngineError(
            f"--engine dask:{path}: this is no scheduler file of Dask (it has no `address`); give the one the scheduler wrote."
        )


# What most tasks import.
MODULES = (
    "numpy",
    "scipy.sparse.linalg",
    "scipy.linalg",
    "scipy.special",
    "sympy",
    "pyomo.environ",
    "h5py",
    "psutil",
    "fmpy",
    "validate.tasks.child",
    "validate.tasks.path",
    "validate.judge.score",
    "validate.judge.replay.run",
    "models.catalog",
    "models.scene.checks",
    "models.codegen.kernel",
    "models.fmu",
    "models.trajectory_netcdf",
    "reports.records.check_record",
    "formulations.mpec",
    "formulations.ipopt",
    "formulations.transcription.homotopy",
    "formulations.contact_modes.session",
    "formulations.multiple_shooting.method",
)
# What one task in four imports: PyTorch, in 1.5 CPU s and half a gigabyte that all children then
# share. Worth it from so many tasks on.
TORCH_MODULES = ("formulations.shooting.session",)
TORCH_WORTH = 20
# From so many tasks on, the process that imports has saved the time of its own start.
WORTH = 4


def preloaded_for(tasks: int) -> Preloaded | None:
    """What the children of so many tasks are forked from, or None where there can be nothing, or it would cost more than it saves.

    It has imported the sources as they are now: one for each campaign.
    """
    if tasks < WORTH or sys.platform != "linux":
        return None
    with contextlib.suppress(MachineError):
        return Preloaded((*MODULES, *TORCH_MODULES) if tasks >= TORCH_WORTH else MODULES)
    return None


@contextmanager
def open_local(jobs: int | None, context: ExecutionContext, tasks: int) -> Iterator[LocalEngine]:
    """The engine of this machine.

    At the end, what runs is stopped. jobs: tasks at a time (None: one a core); tasks: how many
    there are. Raises MachineError.
    """
    engine = LocalEngine(jobs or usable_cores(), context, preloaded_for(tasks))
    try:
        yield engine
    finally:
        with interrupts_wait():
            engine.close()


class LocalEngine:
    """Children on this machine, each watched by a thread. jobs: how many tasks it is to be given at a time."""

    def __init__(self, jobs: int, context: ExecutionContext, preloaded: Preloaded | None) -> None:
        self.jobs, self._context, self._preloaded = jobs, context, preloaded
        self._threads, self._closed = ThreadPoolExecutor(jobs), threading.Event()

    def submit(self, task: Task) -> Future[TaskRecord | None]:
        """Have a task run. Raises MachineError."""
        return self._threads.submit(self._run, task)

    def _run(self, task: Task) -> TaskRecord | None:
        context = self._context
        loaded = context.loaded.get(task.key)
        worker = Worker(
            task,
            context.provenance,
            context.store,
            loaded=loaded,
            preloaded=self._preloaded,
            token_begins=context.token,
        )
        return worker.run(lambda: not self._closed.is_set())

    def result(self, task: Task, future: Future[TaskRecord | None]) -> TaskRecord | None:
        """What came of it, stored; None if it is to be submitted anew.

        Raises MachineError if this machine, or its own, cannot.
        """
        return future.result()

    def why_idle(self, submitted: int) -> str:
        """A sentence why nobody runs what was submitted; empty if nothing is the matter."""
        return ""

    def close(self) -> None:
        """End what runs, and leave nothing of it."""
        self._closed.set()
        self._threads.shutdown(cancel_futures=True)
        if self._preloaded is not None:
            self._preloaded.close()
