"""Run the tasks of a campaign with executors of concurrent.futures, whose futures are records.

    with open_engine("local", 2, context, len(tasks)) as engine:
        future = engine.submit(task)
        record = engine.result(task, future)

The campaign orders the tasks (validate.campaign.campaign). Another engine is a class with `jobs`,
`submit`, `result` and `why_idle`, which starts a Worker for each task. A Worker stores its record.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from models.errors import MachineError, TouchstoneError
from models.results.run import ProvenanceRecord
from touchstone_annexes import load, present
from validate.processes.disk import PARTIAL
from validate.processes.process import Preloaded, interrupts_wait, usable_cores
from validate.store.store import Store
from validate.tasks.path import LoadedRun
from validate.tasks.task import Task, TaskRecord
from validate.tasks.worker import Worker

LOCAL = "local"
# Replaces the key in the name of the campaign's own unfinished folder (validate.campaign.dask).
CAMPAIGN = "campaign"


class EngineError(TouchstoneError):
    """An unknown engine, or an invalid place of one."""


@dataclass(frozen=True, kw_only=True)
class ExecutionContext:
    """The part of a campaign that an engine needs.

    token: 16 letters and digits in the names of the campaign's unfinished folders.
    loaded: the runs that this process has loaded, by key.
    """

    store: Store
    provenance: ProvenanceRecord
    token: str = field(default_factory=lambda: uuid.uuid4().hex[:16])
    loaded: Mapping[str, LoadedRun] = field(default_factory=dict)

    def unfinished(self) -> list[Path]:
        """Return the folders that tasks of the campaign are writing."""
        return [
            path
            for path in self.store.runs.glob(f"{PARTIAL}*-{self.token}*")
            if not path.name.startswith(f"{PARTIAL}{CAMPAIGN}-")
        ]


@dataclass(frozen=True, kw_only=True)
class EngineKind:
    """A kind of engine.

    - forms: spellings of --engine; the first has no place.
    - check: raises EngineError or MachineError for a place that cannot be used.
    - open: returns a context manager for (place, jobs, context, number of tasks).
    """

    forms: tuple[str, ...]
    check: Callable[[str], None]
    open: Callable[[str, int | None, ExecutionContext, int], AbstractContextManager[Any]]


# --engine KIND or KIND:PLACE -> its EngineKind; an annex may be missing.
_KINDS = MappingProxyType({
    LOCAL: "validate.campaign.engine:LOCAL_KIND",
    "dask": "validate.campaign.dask:DASK_KIND",
})  # fmt: skip


def find_engine(name: str) -> tuple[EngineKind, str]:
    """Return the kind and the place of an engine. Raises EngineError for an unknown engine."""
    word, colon, place = name.partition(":")
    kinds = present(_KINDS)
    kind = load(kinds[word]) if word in kinds else None
    if kind is None or (colon and (not place or len(kind.forms) == 1)):
        forms = [form for reference in kinds.values() for form in load(reference).forms]
        words = " and ".join(filter(None, [", ".join(forms[:-1]), forms[-1]]))
        raise EngineError(f"--engine {name}: there is no such engine; the engines are {words}.")
    return kind, place


def check_engine(name: str) -> None:
    """Raise EngineError for an unknown engine, MachineError for a missing package."""
    kind, place = find_engine(name)
    kind.check(place)


def open_engine(
    name: str, jobs: int | None, context: ExecutionContext, tasks: int
) -> AbstractContextManager[Any]:
    """Return the context manager of an engine. Raises EngineError, MachineError."""
    kind, place = find_engine(name)
    return kind.open(place, jobs, context, tasks)


# Modules that most tasks import.
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
    "models.results.stored",
    "formulations.certificate.plan",
    "formulations.ipopt",
    "formulations.transcription.homotopy",
    "formulations.contact_modes.session",
    "formulations.multiple_shooting.method",
)
# Modules that one task in four imports: PyTorch. The import takes 1.5 CPU s and half a gigabyte,
# which all children share.
TORCH_MODULES = ("formulations.shooting.session",)
# Smallest number of tasks for which TORCH_MODULES are imported in advance.
TORCH_WORTH = 20
# Smallest number of tasks for which the importing process saves more than its own start.
WORTH = 4


def preloaded_for(tasks: int) -> Preloaded | None:
    """Return the process from which the tasks' children fork, or None if forking saves no time.

    None also if the system does not support the process. The process has imported the current sources, so that each
    campaign needs its own.
    """
    if tasks < WORTH or sys.platform != "linux":
        return None
    with contextlib.suppress(MachineError):
        return Preloaded((*MODULES, *TORCH_MODULES) if tasks >= TORCH_WORTH else MODULES)
    return None


@contextmanager
def open_local(jobs: int | None, context: ExecutionContext, tasks: int) -> Iterator[LocalEngine]:
    """Open the engine of this machine; at the end, running tasks are stopped.

    jobs: tasks at a time, None for one for each core.
    tasks: number of tasks.

    Raises MachineError.
    """
    engine = LocalEngine(jobs or usable_cores(), context, preloaded_for(tasks))
    try:
        yield engine
    finally:
        with interrupts_wait():
            engine.close()


class LocalEngine:
    """Run tasks in child processes of this machine, each watched by a thread.

    jobs: tasks at a time.
    """

    def __init__(self, jobs: int, context: ExecutionContext, preloaded: Preloaded | None) -> None:
        self.jobs, self._context, self._preloaded = jobs, context, preloaded
        self._threads, self._closed = ThreadPoolExecutor(jobs), threading.Event()

    def submit(self, task: Task) -> Future[TaskRecord | None]:
        """Start a task. Raises MachineError."""
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
        """Return the stored record, or None if the task must be submitted again.

        Raises MachineError if this machine, or the task's machine, cannot run the task.
        """
        return future.result()

    def why_idle(self, submitted: int) -> str:
        """Return the reason why no worker runs the submitted tasks, "" if there is none."""
        return ""

    def close(self) -> None:
        """Stop running tasks and remove their unfinished folders."""
        self._closed.set()
        self._threads.shutdown(cancel_futures=True)
        if self._preloaded is not None:
            self._preloaded.close()


LOCAL_KIND = EngineKind(
    forms=(LOCAL,),
    check=lambda place: None,
    open=lambda place, jobs, context, tasks: open_local(jobs, context, tasks),
)
