"""Where the wall time of a task goes: laps that leave nothing out, so that their sum is the time from the start of the process.

profile = Profile.since_process_start()
profile.lap("imports")          # what passed since the last lap went to imports
profile.split({"build": 0.3, "evaluate": 0.1}, rest="solve_rest")
profile.seconds                 # {"start": .., "imports": .., "build": .., ..}, in order
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

# The name of everything before our first line ran: the interpreter, and waiting for a core.
START = "start"


class Profile:
    """See the module docstring. began: time.monotonic() at which the first lap starts."""

    def __init__(self, began: float, before: float = 0.0) -> None:
        self.began = self._last = began
        self.seconds: dict[str, float] = {START: before} if before > 0.0 else {}

    @classmethod
    def since_process_start(cls) -> Profile:
        """Begins now, with the seconds since the operating system started this process as its first lap (to its clock tick, mostly 10 ms)."""
        return cls(time.monotonic(), max(0.0, _since_process_start()))

    @property
    def total(self) -> float:
        """Seconds of all laps."""
        return sum(self.seconds.values())

    def lap(self, name: str) -> None:
        """Everything since the last lap goes to `name`, in addition to what it has."""
        self.split({}, rest=name)

    def split(self, parts: Mapping[str, float], rest: str) -> None:
        """The lap that ends here, divided: `parts` [s] by name, what they leave of it goes to `rest`.

        Parts that claim more than the lap took (they are read from other clocks) are scaled to it.
        """
        now = time.monotonic()
        took, self._last = now - self._last, now
        known = {name: seconds for name, seconds in parts.items() if seconds > 0.0}
        claimed = sum(known.values())
        scale = min(1.0, took / claimed) if claimed > 0.0 else 0.0
        for name, seconds in known.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + scale * seconds
        self.seconds[rest] = self.seconds.get(rest, 0.0) + took - scale * claimed


def _since_process_start() -> float:
    """The age of this process [s].

    Linux counts starts from its boot, which it tells by the clock on the wall in whole seconds
    only: a start told by that clock, as psutil's is, would be up to a second too early.
    """
    try:
        with open("/proc/self/stat", encoding="utf-8", errors="replace") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError):  # another system than Linux
        import psutil

        return time.time() - psutil.Process().create_time()
