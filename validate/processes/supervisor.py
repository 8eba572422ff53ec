"""Supervisor of a child: starts it, ends all its processes, and reports how it ended.

    python -P -m validate.processes.supervisor 5            # 5: socket of the order
    python -P -m validate.processes.supervisor 5 numpy ..   # import, then fork supervisors

On Linux orphans of the child become the supervisor's children, so that none escapes. When the
socket closes, our process has ended: the supervisor kills the rest and removes the child's
unfinished folder. A child dies with its supervisor. Other side: validate.processes.process.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import select
import shutil
import signal
import socket
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

# Length of an order's JSON [bytes].
LENGTH = struct.Struct("=i")
# Ending of a child: exit code (negative: signal), remaining processes, CPU seconds, largest
# resident
# size and address space [bytes].
ENDED = struct.Struct("=iidqq")
# Message of a preloaded process after its imports.
READY = b"r"
_PARENT_DEATH_SIGNAL = 1  # option of prctl
_CHILD_SUBREAPER = 36  # option of prctl
# Interval between looks at a child's memory [s].
_LOOK = 0.02
# Rounds of killing descendants; a new fork is killed in the next round. In all 10 s.
_ROUNDS = 1000
# Pause between rounds [s].
_PAUSE = 0.01


def _process_control(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def _supervise(channel: socket.socket) -> NoReturn:
    """Run the child of the order, or keep its folder without one, until the caller closes."""
    _process_control(_CHILD_SUBREAPER, 1)
    (length,) = LENGTH.unpack(channel.recv(LENGTH.size, socket.MSG_WAITALL) or LENGTH.pack(0))
    order = json.loads(channel.recv(length, socket.MSG_WAITALL) or "{}")
    ended = _run(order, channel) if order.get("function") else b""
    with contextlib.suppress(OSError):
        channel.sendall(ended)
        while channel.recv(1):  # the caller was interrupted while reading, and asks again
            channel.sendall(ended)
    if os.path.basename(order.get("folder", "")).startswith(
        ".partial-"
    ):  # nothing else may be removed
        shutil.rmtree(order["folder"], ignore_errors=True)
    os._exit(0)


def _run(order: dict[str, Any], channel: socket.socket) -> bytes:
    """Run the child and end its family; return how it ended."""
    woken, wake = os.pipe()  # reports a child's end at once
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    supervisor = os.getpid()
    child = os.fork()
    if child == 0:
        signal.set_wakeup_fd(-1)
        for descriptor in (channel.detach(), woken, wake):
            os.close(descriptor)
        be_child(order, lambda: _die_with(supervisor))
    space, ended = 0, 0
    while ended != child:
        ready, _, _ = select.select([channel, woken], [], [], _LOOK)
        space = max(space, _address_space(child))
        if channel in ready:  # an order to end, or the caller is gone
            os.kill(child, signal.SIGKILL)
        elif ready:
            os.read(woken, 4096)
        # Orphans that ended must not stay in the process table.
        ended, status, usage = os.wait4(child, 0) if channel in ready else os.wait4(-1, os.WNOHANG)
    strays = _end_family(child)
    resident = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return ENDED.pack(
        os.waitstatus_to_exitcode(status), strays, usage.ru_utime + usage.ru_stime, resident, space
    )


def _end_family(child: int) -> int:
    """End all descendants of an ended child; return how many lived."""
    if sys.platform != "linux":  # escaped processes are invisible there
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child, signal.SIGKILL)
    strays: set[int] = set()
    for _ in range(_ROUNDS):
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        living = _descendants(os.getpid())
        if not living:
            break
        strays.update(living)
        for number in living:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(number, signal.SIGKILL)
        time.sleep(_PAUSE)
    return len(strays)


def _descendants(parent: int) -> list[int]:
    """Return all descendants on Linux; psutil would read the whole process table."""
    descendants = []
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{parent}/task"):
            with open(f"/proc/{parent}/task/{thread}/children", encoding="ascii") as file:
                for number in map(int, file.read().split()):
                    descendants += [number, *_descendants(number)]
    return descendants


def _address_space(process: int) -> int:
    with (
        contextlib.suppress(OSError),
        open(f"/proc/{process}/status", encoding="utf-8", errors="replace") as file,
    ):
        for line in file:
            if line.startswith("VmPeak:"):
                return 1024 * int(line.split()[1])
    return 0


def _die_with(supervisor: int) -> None:
    """End this process with its parent, which may have ended already."""
    _process_control(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != supervisor:  # it died first
        os._exit(1)


def be_child(order: Mapping[str, Any], bind: Callable[[], object]) -> NoReturn:
    """Run the ordered function in its own session, folder, output and environment.

    bind: ties this process to the caller's life. No exit handlers run, so that a library that
    crashes while unloading spoils nothing.
    """
    try:
        os.setsid()
        for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.environ.clear()
        os.environ.update(order["environment"])
        tempfile.tempdir = None
        nothing = os.open(os.devnull, os.O_RDONLY)  # foreign code must not read the terminal
        os.dup2(nothing, 0)
        os.close(nothing)
        output = os.open(order["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.close(output)
        bind()
        os.chdir(order["environment"]["TMPDIR"])
        module, _, name = order["function"].partition(":")
        code = getattr(importlib.import_module(module), name)(Path(order["folder"])) or 0
    except BaseException:  # noqa: BLE001 - printed; a missing answer is enough for the parent
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):  # foreign code may have closed them
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _fork_supervisors(channel: socket.socket, modules: Sequence[str]) -> None:
    """Import modules, then fork a supervisor per received socket until the channel closes."""
    _process_control(_PARENT_DEATH_SIGNAL, signal.SIGKILL)  # also during an import
    for name in modules:
        with contextlib.suppress(
            ImportError
        ):  # a missing extra, or an error that the task reports itself
            importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:  # a fork would break a library's threads
        return
    gc.collect()
    gc.freeze()  # keeps shared memory shared during a child's garbage collection
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    channel.sendall(READY)
    while sockets := socket.recv_fds(channel, 1, 1)[1]:
        if os.fork() == 0:
            channel.close()
            os.setsid()
            _supervise(socket.socket(fileno=sockets[0]))
        os.close(sockets[0])


def main(words: Sequence[str]) -> None:
    """Start; words: number of the socket, and modules. Ctrl-C is for the caller."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    channel = socket.socket(fileno=int(words[0]))
    if len(words) > 1:
        _fork_supervisors(channel, words[1:])
    else:
        _supervise(channel)


if __name__ == "__main__":
    main(sys.argv[1:])
