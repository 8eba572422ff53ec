"""A child that is a fork of this process, for code of our own: it has imported already what it needs, which takes a third of a replay.

    if can_fork():
        child = Fork("module:work", folder, temporary=folder / "tmp", output=file)      # calls work(folder) there
        child.wait(60.0), child.end()                                           # whether it ended; how, and what it cost

Foreign code gets a process of its own (validate.execution.process), of which whatever it starts is found. Here nothing is looked for. When this process
is killed, the child removes its folder and ends.
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
from pathlib import Path
from typing import IO

from validate.execution.process import Ended


def can_fork() -> bool:
    """Whether this process may be forked: on Linux, and with one thread, as another would be cut off amid its work."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


class Fork:
    """See the module docstring."""

    def __init__(self, work: str, folder: Path, *, temporary: Path, output: IO[bytes]) -> None:
        module, _, name = work.partition(":")
        function = getattr(importlib.import_module(module), name)
        sys.stdout.flush()
        sys.stderr.flush()
        self._line, line = socket.socketpair()  # each side hears the end of the other
        self._pid = os.fork()
        if self._pid == 0:
            try:
                os.setsid()
                self._line.close()
                with open(os.devnull, "rb") as nothing:
                    for standard, file in enumerate((nothing, output, output)):
                        os.dup2(file.fileno(), standard)
                tempfile.tempdir = str(temporary)
                os.chdir(temporary)
                threading.Thread(target=_end_with, args=(line, folder), daemon=True).start()
                function(folder)
            finally:
                os._exit(1)
        line.close()

    def wait(self, seconds: float) -> bool:
        """Wait at most that long [s]; whether it ended."""
        return bool(select.select([self._line], [], [], max(0.0, seconds))[0])

    def address_space(self) -> int:
        """As ChildProcess: it is not known here, where `end` tells the resident memory."""
        return 0

    def look(self) -> None:
        """As ChildProcess: nothing is looked for."""

    def end(self) -> Ended:
        """End it, if it lives."""
        os.kill(self._pid, signal.SIGKILL)
        _, status, usage = os.wait4(self._pid, 0)
        self._line.close()
        return Ended(code=os.waitstatus_to_exitcode(status), cpu=usage.ru_utime + usage.ru_stime, memory=1024 * usage.ru_maxrss, strays=0)


def _end_with(line: socket.socket, folder: Path) -> None:
    """In the child: wait for the end of its parent, whatever C code runs beside, and leave nothing."""
    line.recv(1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
