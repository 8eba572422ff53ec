"""The report of a campaign while it runs: written again as scenes end, beside the tasks.

with GrowingReport(write) as report:
report.update()             # a scene has ended
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from models.errors import MachineError

# Writing may take so much of the time at most: with every core at work it delays the tasks.
_SHARE = 0.05


class GrowingReport:
    """See the module docstring. write: writes the whole report of what is stored now."""

    def __init__(self, write: Callable[[], object]) -> None:
        self._write = write
        self._thread = ThreadPoolExecutor(1)
        self._writing: Future[float] | None = None
        self._next = 0.0  # time.monotonic() before which it is not written again

    def update(self) -> None:
        """Write it, unless that is at work already, or has been a short while ago."""
        if self._writing is not None:
            if not self._writing.done():
                return
            self._next = time.monotonic() + self._writing.result() / _SHARE
            self._writing = None
        if time.monotonic() >= self._next:
            self._writing = self._thread.submit(self._written)

    def _written(self) -> float:
        """Seconds that it took [s]. What the disk refuses is said at the end, where it comes again."""
        began = time.monotonic()
        with contextlib.suppress(MachineError):
            self._write()
        return time.monotonic() - began

    def __enter__(self) -> GrowingReport:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._thread.shutdown(cancel_futures=True)
