"""Rewrite the report of a running campaign in a thread whenever a scene ends.

with closing(GrowingReport(write, print)) as report:
    report.update()  # after the end of a scene
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

# Largest share of the campaign's time for rewriting; on busy cores rewriting delays the tasks.
_SHARE = 0.05


class GrowingReport:
    """Rewrite a report at most once at a time.

    write: writes the report and returns its path.
    first: called with the path after the first write.
    """

    def __init__(self, write: Callable[[], Path], first: Callable[[Path], None]) -> None:
        self._write = write
        self._first: Callable[[Path], None] | None = first
        self._thread = ThreadPoolExecutor(1)
        self._writing: Future[float] | None = None
        self._next = 0.0  # earliest time.monotonic() of the next rewrite

    def update(self) -> None:
        """Start a rewrite, unless one is running or the last one ended too recently."""
        if self._writing is not None:
            if not self._writing.done():
                return
            self._next = time.monotonic() + self._writing.result() / _SHARE
            self._writing = None
        if time.monotonic() >= self._next:
            self._writing = self._thread.submit(self._timed_write)

    def _timed_write(self) -> float:
        """Write the report and return the duration [s].

        Errors are ignored; the last write of the campaign raises them.
        """
        began = time.monotonic()
        with contextlib.suppress(Exception):
            path = self._write()
            if self._first is not None:
                self._first(path)
                self._first = None
        return time.monotonic() - began

    def close(self) -> None:
        """Wait for the running rewrite."""
        self._thread.shutdown(cancel_futures=True)
