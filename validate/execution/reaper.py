"""Leaves nothing behind: ends every process of a child (a task, an isolated FMU), and removes its unfinished folder, even when we are killed.

A child runs in a session of its own, and every process it starts inherits an environment variable with the child's token (a child of a
child: with both tokens). So all of them are found: by process group, and on Linux by the token even if one of them left the group.

Run as a script, this file is the watchdog of a process that has children: it reads from its standard input which of them live, and when that pipe
closes - their parent ended, in whatever way - it ends what still lives. Every replay starts it, so that it imports next to nothing: it starts in 12 ms.

    start <token> <folder>      stop <token>

The folder is a partial one of ours, or that of `multiprocessing` for its sockets.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time

TOKEN_VARIABLE = "TOUCHSTONE_TASK_TOKEN"
# Processes that fork while they are being found are found in the next round; 100 rounds of 10 ms outlast any that does not fork for ever.
_ROUNDS, _PAUSE = 100, 0.01


def processes_with(token: str) -> list[int]:
    """Living processes (not zombies) whose environment carries the token; empty where there is no /proc."""
    start, mark = f"{TOKEN_VARIABLE}=".encode(), token.encode()
    found = []
    for name in filter(str.isdecimal, os.listdir("/proc") if os.path.isdir("/proc") else ()):
        with contextlib.suppress(OSError), open(f"/proc/{name}/environ", "rb") as file:
            for variable in file.read().split(b"\0"):
                if variable.startswith(start) and mark in variable.removeprefix(start).split(b","):
                    found.append(int(name))
    return found


def end_all(token: str, group: int | None = None) -> set[int]:
    """Kill every process of a child: its process group, and all that carry its token. Returns when none is left; those that lived."""
    ended: set[int] = set()
    for _ in range(_ROUNDS):
        living = processes_with(token)  # 5 ms where a machine has a hundred: a child that left nothing is looked for once
        if group is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(group, signal.SIGKILL)
        if not living:
            break
        ended.update(living)
        for process in living:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        time.sleep(_PAUSE)
    return ended


def watch() -> None:
    """The watchdog: see the module docstring."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    living: dict[str, str] = {}
    for line in sys.stdin.buffer:
        verb, token, *folder = os.fsdecode(line).rstrip("\n").split(" ", 2)
        if verb == "start":
            living[token] = folder[0]
        else:
            living.pop(token, None)
    for token, path in living.items():
        end_all(token)
        if os.path.basename(path).startswith((".partial-", "pymp-")):  # nothing else is ours to remove, whatever the pipe said
            import shutil  # as long to import as all the rest, and seldom needed

            shutil.rmtree(path, ignore_errors=True)


if __name__ == "__main__":
    watch()
