"""Engines run the cells of a campaign, each in its own child process, and hand back records as cells finish.

    for cell, record in LocalEngine(start, jobs=2).run(cells): ...

Another engine (a cluster's scheduler) is another class with the same `run`: it needs `start` on the machine where a cell
runs and nothing else, since a Worker stores what it finished by itself.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from reports.examination_record import ExaminationRecord
    from reports.record import RunRecord
    from validate.worker import Job, Worker

# How often children are looked at [s]: far below the 0.3 s a cell takes to start, and 20 cheap system calls a second.
_LOOK = 0.05


class Engine(Protocol):
    def run(self, cells: Sequence[Job]) -> Generator[tuple[Job, RunRecord | ExaminationRecord], None, None]:
        """Run all cells; yield each with its record when it has finished. Closing the iterator stops what runs."""
        ...


class LocalEngine:
    """At most `jobs` children at a time on this machine, started and watched from this one thread.

    (From one thread because Linux kills a child when the thread that started it ends.) watch: called with the running workers at
    each look; must_wait: whether a cell is to be left for later while others run.
    """

    def __init__(
        self,
        start: Callable[[Job], Worker],
        jobs: int,
        watch: Callable[[Sequence[Worker]], None] = lambda workers: None,
        must_wait: Callable[[Job, Sequence[Job]], bool] = lambda cell, running: False,
    ) -> None:
        self._start, self._jobs, self._watch, self._must_wait = start, jobs, watch, must_wait

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
