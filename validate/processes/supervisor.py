"""The supervisor of a child: a process between the child and us, which starts it, ends all that it started, and says how it ended.

    python -P -m validate.processes.supervisor 5  # 5: the socket over which it is told what to run
    # imports these, then forks a supervisor for each socket that it is sent
    python -P -m validate.processes.supervisor 5 numpy ..

Linux makes it the parent of whatever its child leaves behind, in whatever session and with whatever
environment, so that nothing gets away. When its socket closes, we have ended, in whatever way: then
it ends what still lives, and removes the child's unfinished folder. A child dies with its
supervisor. The other side of the socket: validate.processes.process.
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

# What an order begins with: how many bytes of JSON it has.
LENGTH = struct.Struct("=i")
# How a child ended: its exit code, negative for a signal; its processes that were left; CPU
# seconds; largest resident size and address space [bytes].
ENDED = struct.Struct("=iidqq")
# What a process that others are forked from says once it has imported everything.
READY = b"r"
# Of prctl.
_PARENT_DEATH_SIGNAL = 1
_CHILD_SUBREAPER = 36
# How often the memory of a child is looked at [s].
_LOOK = 0.02
# How often, and how long apart [s], we look whether what was killed is gone: 10 s, on the busiest
# machine. What forks meanwhile is found in the next round.
_ROUNDS = 1000
_PAUSE = 0.01


def _process_control(option: int, value: int) -> None:
    """Linux: what a process asks of the system for itself."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def _supervise(channel: socket.socket) -> NoReturn:
    """Run the child that is asked for over the channel, or keep its folder without one.

    Then wait until whoever asked has put away what it left.
    """
    _process_control(_CHILD_SUBREAPER, 1)
    (length,) = LENGTH.unpack(channel.recv(LENGTH.size, socket.MSG_WAITALL) or LENGTH.pack(0))
    order = json.loads(channel.recv(length, socket.MSG_WAITALL) or "{}")
    ended = _run(order, channel) if order.get("function") else b""
    with contextlib.suppress(OSError):
        channel.sendall(ended)
        while channel.recv(
            1
        ):  # Ctrl-C came while the answer was read, which is asked for once more
            channel.sendall(ended)
    if os.path.basename(order.get("folder", "")).startswith(
        ".partial-"
    ):  # nothing else is ours to remove, whatever the channel said
        shutil.rmtree(order["folder"], ignore_errors=True)
    os._exit(0)


def _run(order: dict[str, Any], channel: socket.socket) -> bytes:
    """How the child ended, and all that it started with it."""
    woken, wake = os.pipe()  # a child's end is seen at once
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
        if channel in ready:  # it is to end, or nobody is there any more
            os.kill(child, signal.SIGKILL)
        elif ready:
            os.read(woken, 4096)
        # Of what the child has left behind, and what has ended since, nothing stays in the table of
        # processes.
        ended, status, usage = os.wait4(child, 0) if channel in ready else os.wait4(-1, os.WNOHANG)
    strays = _end_family(child)
    resident = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return ENDED.pack(
        os.waitstatus_to_exitcode(status), strays, usage.ru_utime + usage.ru_stime, resident, space
    )


def _end_family(child: int) -> int:
    """End all that a child started, which has ended itself; how many lived.

    Returns when none does.
    """
    if sys.platform != "linux":  # nothing shows there what left the group
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
    """Linux: the children of a process, and theirs. psutil would read the whole table of processes for that."""
    found = []
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{parent}/task"):
            with open(f"/proc/{parent}/task/{thread}/children", encoding="ascii") as file:
                for number in map(int, file.read().split()):
                    found += [number, *_descendants(number)]
    return found


def _address_space(process: int) -> int:
    """Largest address space so far [bytes]; 0 where it is not known."""
    with (
        contextlib.suppress(OSError),
        open(f"/proc/{process}/status", encoding="utf-8", errors="replace") as file,
    ):
        for line in file:
            if line.startswith("VmPeak:"):
                return 1024 * int(line.split()[1])
    return 0


def _die_with(supervisor: int) -> None:
    """Have this process end with the one that it was forked from, which may have ended already."""
    _process_control(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != supervisor:  # it died before we could ask
        os._exit(1)


def be_child(order: Mapping[str, Any], bind: Callable[[], object]) -> NoReturn:
    """Be the child: a session, folder, output and environment of its own, then the function that is asked for. bind: to the life of whoever asked.

    Nobody's exit handlers are run: a library that crashes while it is unloaded cannot spoil what is
    finished.
    """
    try:
        os.setsid()
        for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.environ.clear()
        os.environ.update(order["environment"])
        tempfile.tempdir = None
        nothing = os.open(
            os.devnull, os.O_RDONLY
        )  # foreign code that reads shall not wait for whoever types
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
    except BaseException:  # noqa: BLE001 - whatever it was, it goes to the output; without an answer the parent knows enough
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):  # foreign code may have closed them
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _fork_supervisors(channel: socket.socket, modules: Sequence[str]) -> None:
    """Import, then fork a supervisor for each socket that comes over the channel, until it closes."""
    _process_control(_PARENT_DEATH_SIGNAL, signal.SIGKILL)  # also in the midst of an import
    for name in modules:
        with contextlib.suppress(
            ImportError
        ):  # an extra that is not installed, or what a task will say itself
            importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:  # a fork would cut a library's threads in two
        return
    gc.collect()
    gc.freeze()  # so that what is shared stays shared when a child looks for garbage
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    channel.sendall(READY)
    while sockets := socket.recv_fds(channel, 1, 1)[1]:
        if os.fork() == 0:
            channel.close()
            os.setsid()
            _supervise(socket.socket(fileno=sockets[0]))
        os.close(sockets[0])


def main(words: Sequence[str]) -> None:
    """See the module docstring. words: the number of the socket, and what to import.

    Ctrl-C and a closed terminal are for whoever asked.
    """
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
