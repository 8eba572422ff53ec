"""Profile of a task: laps whose sum is the time since the start of the process.

profile = Profile.since_process_start()
profile.lap("imports")  # time since the last lap
profile.split({"build": 0.3, "evaluate": 0.1}, rest="solve_rest")
profile.seconds         # {"start": .., "imports": .., "build": .., ..}, in order
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

# Time before our first line: interpreter start, and waiting for a core.
START = "start"


def waits(wall: float, cpu: float) -> str:
    """Return a sentence with a leading space if others had more of the core than a task, else ''.

    wall, cpu: time of the task [s]
    """
    if wall <= 2.0 * cpu:
        return ""
    return f" The machine was busy: it gave {cpu:.3g} CPU s in {wall:.3g} s."


class Profile:
    """Laps from `began` by time.monotonic()."""

    def __init__(self, began: float, before: float = 0.0) -> None:
        self.began = self._last = began
        self.seconds: dict[str, float] = {START: before} if before > 0.0 else {}

    @classmethod
    def since_process_start(cls) -> Profile:
        """Return a profile with the process's age as first lap (clock tick: mostly 10 ms)."""
        return cls(time.monotonic(), max(0.0, _since_process_start()))

    @property
    def total(self) -> float:
        """Return the seconds of all laps."""
        return sum(self.seconds.values())

    def lap(self, name: str) -> None:
        """Add the time since the last lap to `name`."""
        self.split({}, rest=name)

    def split(self, parts: Mapping[str, float], rest: str) -> None:
        """End a lap: `parts` [s] by name, the remainder to `rest`.

        Parts from other clocks that exceed the lap are scaled to it.
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
    """Return the age of this process [s].

    On Linux by ticks since boot: psutil's wall-clock start is up to a second early.
    """
    try:
        with open("/proc/self/stat", encoding="utf-8", errors="replace") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError):  # not Linux
        import psutil

        return time.time() - psutil.Process().create_time()
