"""A child that is a fork of this process, for code of our own: it has imported already what it needs, which takes a third of a replay.

    if can_fork():
        child = Fork("module:main", folder, output=folder / "output.txt")    # calls main(folder) there
        child.wait(60.0), child.end()                                   # whether it ended; how, and what it cost

Foreign code gets a process of its own under a supervisor (validate.execution.process), which finds whatever it starts. Here nothing is looked for. When
this process is killed, the child removes its folder and ends.
"""

from __future__ import annotations

import importlib
import os
import select
import shutil
import signal
import socket
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from pathlib import Path

from validate.execution.process import TEMPORARY, Ended


def can_fork() -> bool:
    """Whether this process may be forked: on Linux, and with one thread, as another would be cut off amid its work."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


class Fork:
    """See the module docstring; used like `Child`."""

    _ended: Ended | None = None

    def __init__(self, function: str, folder: Path, *, output: Path) -> None:
        module, _, name = function.partition(":")
        work = getattr(importlib.import_module(module), name)
        sys.stdout.flush()
        sys.stderr.flush()
        self._line, line = socket.socketpair()  # each side hears the end of the other
        self._pid = os.fork()
        if self._pid == 0:
            self._line.close()
            _be_child(work, folder, output, line)
        line.close()

    def wait(self, seconds: float) -> bool:
        """Wait at most that long [s]; whether it ended."""
        return self._ended is not None or bool(select.select([self._line], [], [], max(0.0, seconds))[0])

    def end(self) -> Ended:
        """End it, if it lives; once more, it says the same."""
        if self._ended is None:
            os.kill(self._pid, signal.SIGKILL)
            _, status, usage = os.wait4(self._pid, 0)
            code, cpu = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
            self._ended = Ended(code=code, cpu=cpu, memory=1024 * usage.ru_maxrss)
        return self._ended

    def close(self) -> None:
        """End it. Its folder stays."""
        self.end()
        self._line.close()


def _be_child(work: Callable[[Path], int | None], folder: Path, output: Path, line: socket.socket) -> None:
    """Nobody's exit handlers are run: a library that crashes while it is unloaded cannot spoil what is finished."""
    code = 1
    try:
        os.setsid()
        with open(os.devnull, "rb") as nothing, open(output, "wb") as file:
            for standard, stream in enumerate((nothing, file, file)):
                os.dup2(stream.fileno(), standard)
        tempfile.tempdir = str(folder / TEMPORARY)
        os.chdir(folder / TEMPORARY)
        threading.Thread(target=_end_with, args=(line, folder), daemon=True).start()
        code = work(folder) or 0
    except BaseException:  # noqa: BLE001 - it goes to the output; without an answer the parent knows enough
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _end_with(line: socket.socket, folder: Path) -> None:
    """In the child: wait for the end of its parent, whatever C code runs beside, and leave nothing."""
    line.recv(1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
