"""Run tasks in the order of their dependencies, on an engine (validate.campaign.engine).

for record in run_tasks(tasks, engine, context, retries=0, narrator=narrator):
    ...
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Protocol

from validate.campaign.engine import ExecutionContext
from validate.tasks.task import RunTask, Task, TaskRecord, path_of

# Longest pause between two calls of `Narrator.runs` [s].
_POLL_S = 0.2
# Pause between two checks whether the engine has workers [s].
_IDLE_CHECK_S = 5.0


class Engine(Protocol):
    """An engine that runs tasks."""

    @property
    def jobs(self) -> int | None:
        """Return the number of tasks at a time, None for all."""
        ...

    def submit(self, task: Task) -> Future[TaskRecord | None]:
        """Start a task."""
        ...

    def result(self, task: Task, future: Future[TaskRecord | None]) -> TaskRecord | None:
        """Return the stored record, or None if the task must be submitted again."""
        ...

    def why_idle(self, submitted: int) -> str:
        """Return the reason why no worker runs the submitted tasks, "" if there is none."""
        ...


class Listener(Protocol):
    """Prints running tasks and warnings."""

    def warns(self, sentence: str) -> None:
        """Print a warning."""

    def runs(self, folders: dict[str, Path]) -> None:
        """Print the running tasks; called several times a second.

        folders: title of each running task -> its folder.
        """


def dependencies(tasks: Iterable[Task]) -> dict[str, set[str]]:
    """Return the keys of the tasks that must end before each task, by key.

    The first of several runs with a common leg makes the leg. A run that reads legs of other runs
    (`RunTask.uses`) waits for their makers.
    """
    makers: dict[str, str] = {}
    found: dict[str, set[str]] = {}
    runs = [task for task in tasks if isinstance(task, RunTask)]
    for task in runs:
        keys = [key for leg in path_of(task) for key in (leg.key, leg.alone)]
        found[task.key] = {makers[key] for key in keys if key in makers}
        for key in keys:
            makers.setdefault(key, task.key)
    users = {task.key for task in runs if task.uses}
    for task in runs:
        # Runs that use legs do not wait for each other, so that no cycle arises.
        found[task.key] |= {makers[key] for key in task.uses if key in makers} - users
    return {task.key: found.get(task.key, set()) - {task.key} for task in tasks}


def run_tasks(
    tasks: Sequence[Task],
    engine: Engine,
    context: ExecutionContext,
    retries: int,
    narrator: Listener,
) -> Generator[TaskRecord, None, None]:
    """Run all tasks and yield the record of each finished task.

    retries: number of retries of a task that crashes; a retry precedes waiting tasks.

    Raises MachineError.
    """
    by_key = {task.key: task for task in tasks}
    order = {key: place for place, key in enumerate(by_key)}
    sorter = TopologicalSorter(dependencies(tasks))
    sorter.prepare()
    ready: list[Task] = []
    running: dict[Future[TaskRecord | None], Task] = {}
    crashes = Counter[str]()
    checked, reported = time.monotonic(), ""
    while sorter.is_active():
        ready += [by_key[key] for key in sorter.get_ready()]
        ready.sort(key=lambda task: (-crashes[task.key], order[task.key]))
        while ready and (engine.jobs is None or len(running) < engine.jobs):
            task = ready.pop(0)
            running[engine.submit(task)] = task
        narrator.runs(_begun(running.values(), context))
        if time.monotonic() - checked > _IDLE_CHECK_S:
            checked, why = time.monotonic(), engine.why_idle(len(running))
            if why and why != reported:
                narrator.warns(why)
            reported = why
        for future in wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED).done:
            task = running.pop(future)
            record = engine.result(task, future)
            if record is None:
                running[engine.submit(task)] = task
            elif record.outcome == "crashed" and crashes[task.key] < retries:
                crashes[task.key] += 1
                narrator.warns(f"{task.title} crashed and will be tried again: {record.message}")
                ready.append(task)
            else:
                sorter.done(task.key)
                yield record


def _begun(tasks: Iterable[Task], context: ExecutionContext) -> dict[str, Path]:
    """Return title -> unfinished folder of the tasks that have one, on any machine."""
    folders = {path.name.split("-")[1]: path for path in context.unfinished()}
    return {task.title: folders[task.key[:12]] for task in tasks if task.key[:12] in folders}
