"""Child processes under a supervisor, for tasks and isolated FMUs.

    child = Child("validate.tasks.child:main", folder, output=folder / "log.txt")  # main(folder)
    while not child.wait(0.05): ...
    ended = child.end()                 # ends all its processes
    child.close()                       # removes the folder

A child has one thread per library, no hash randomisation and its own temporary files. Our own code
may run in a `Fork` of this process, which saves imports, a third of a replay. A fork has no
supervisor; it removes its folder and ends if this process is killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from models.errors import MachineError
from validate.processes.supervisor import ENDED, LENGTH, READY, be_child

# Signals that end a campaign with a message: Ctrl-C, kill, a closed terminal.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Delay KeyboardInterrupt to the end of the block; a second one is immediate.

    Only in the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def hear(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            signal.default_int_handler(number, frame)

    mine = [number for number in ENDING if signal.getsignal(number) is signal.default_int_handler]
    for number in mine:
        signal.signal(number, hear)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.default_int_handler)
    if received:
        raise KeyboardInterrupt


ROOT = Path(__file__).resolve().parents[2]
# Subfolder of a child's temporary files.
TEMPORARY = "tmp"
# One thread per library: comparable times, one order of sums, and N cores for -j N.
THREADS = 1

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def usable_cores() -> int:
    """Return the number of cores that this process may use, fewer in a container."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def child_environment(temporary: Path | None = None) -> dict[str, str]:
    """Return the environment of a child; temporary: its folder for temporary files."""
    python_path = [
        str(Path(part).resolve())
        for part in os.environ.get("PYTHONPATH", "").split(os.pathsep)
        if part
    ]
    # The child must import what `python -m` lets the parent import.
    here = [os.getcwd()] if {"", os.getcwd()} & set(sys.path) else []
    return {
        **os.environ,
        **dict.fromkeys(_THREAD_VARIABLES, str(THREADS)),
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *python_path, *here]),
        **({} if temporary is None else {"TMPDIR": str(temporary)}),
    }


def _start_supervisor(
    channel: socket.socket, environment: Mapping[str, str], modules: Sequence[str] = ()
) -> subprocess.Popen[bytes]:
    # -P: do not search the current folder for modules.
    command = [
        sys.executable,
        "-P",
        "-m",
        "validate.processes.supervisor",
        str(channel.fileno()),
        *modules,
    ]
    nothing = subprocess.DEVNULL
    try:
        return subprocess.Popen(
            command,
            stdin=nothing,
            stdout=nothing,
            stderr=nothing,
            pass_fds=[channel.fileno()],
            cwd="/",
            env=environment,
            start_new_session=True,
        )
    except OSError as error:
        raise MachineError(
            f"a process cannot be started ({error.strerror}). End other processes."
        ) from error


class Preloaded:
    """A process with loaded modules that forks supervisors, which saves a second per child.

    Linux only. Raises MachineError if a library has started threads, or the start fails.
    """

    def __init__(self, modules: Sequence[str]) -> None:
        self._channel, other = socket.socketpair()
        with other:
            self._process = _start_supervisor(other, child_environment(), modules)
        try:
            ready = self._channel.recv(1) == READY
        except BaseException:
            self.close()
            raise
        if not ready:
            self.close()
            raise MachineError("supervisors cannot be forked: a library has started threads.")

    def fork(self, channel: socket.socket) -> bool:
        """Fork a supervisor at the other end of a channel; return False if this process ended."""
        with contextlib.suppress(OSError):
            socket.send_fds(self._channel, [b"f"], [channel.fileno()])
            return self._process.poll() is None
        return False

    def close(self) -> None:
        """End the process; its supervisors live on."""
        self._process.kill()
        self._process.wait()
        self._channel.close()


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a child ended.

    - code: exit code, negative for a signal.
    - strays: remaining processes, ended.
    - cpu [s]: of the child and its waited-for children.
    - memory, space: largest resident size and address space [bytes], 0 if unknown.
    """

    code: int
    strays: int = 0
    cpu: float = 0.0
    memory: int = 0
    space: int = 0


class KeptFolder:
    """A folder that is removed on close or when our process ends. Raises MachineError.

    Its name begins with `.partial-`.
    """

    def __init__(
        self,
        folder: Path,
        order: Mapping[str, Any] | None = None,
        preloaded: Preloaded | None = None,
    ) -> None:
        self._folder, self._supervisor = folder, None
        environment = child_environment(folder / TEMPORARY)
        self._channel, other = socket.socketpair()
        with other:
            if preloaded is None or not preloaded.fork(other):
                self._supervisor = _start_supervisor(other, environment)
        message = json.dumps(
            {"folder": str(folder), "environment": environment, **(order or {})}
        ).encode()
        with contextlib.suppress(OSError):  # the supervisor was killed, and the child with it
            self._channel.sendall(LENGTH.pack(len(message)) + message)

    def close(self) -> None:
        """Remove the folder, and wait for the supervisor."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._channel.shutdown(socket.SHUT_WR)
            while self._channel.recv(ENDED.size):
                pass
        self._channel.close()
        if self._supervisor is not None:
            self._supervisor.wait()


class Child(KeptFolder):
    """A function of ours in its own process. Raises MachineError.

    - function: `module:name`, called with folder, which has TEMPORARY.
    - output: file for its output.
    - preloaded: process to fork the supervisor from.
    """

    _ended: Ended | None = None

    def __init__(
        self, function: str, folder: Path, *, output: Path, preloaded: Preloaded | None = None
    ) -> None:
        super().__init__(folder, {"function": function, "output": str(output)}, preloaded)

    def wait(self, seconds: float) -> bool:
        """Wait at most this long [s]; return whether the child ended."""
        if self._ended is None and select.select([self._channel], [], [], max(0.0, seconds))[0]:
            self._ended = self._hear()
        return self._ended is not None

    def end(self) -> Ended:
        """End the child and all its processes; repeated calls return the same."""
        if self._ended is None:
            with contextlib.suppress(OSError):
                self._channel.send(b"e")
            self._ended = self._hear()
        return self._ended

    def _hear(self) -> Ended:
        message = b""
        with contextlib.suppress(OSError):
            message = self._channel.recv(ENDED.size, socket.MSG_WAITALL)
        if len(message) == ENDED.size:
            code, strays, cpu, memory, space = ENDED.unpack(message)
            return Ended(code=code, strays=strays, cpu=cpu, memory=memory, space=space)
        return Ended(code=-signal.SIGKILL, strays=_end_users_of(self._folder))

    def close(self) -> None:
        """End the child, and remove its folder."""
        self.end()
        super().close()


def _end_users_of(folder: Path) -> int:
    """End processes with temporary files in this folder, after a killed supervisor."""
    import psutil  # 0.05 s

    count = 0
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if Path(process.environ().get("TMPDIR", "/")).is_relative_to(folder):
                process.kill()
                count += 1
    return count


def exit_in_words(code: int) -> str:
    """Return `exit code 3` or `signal 11 (SIGSEGV)`."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"signal {-code}"


def can_fork() -> bool:
    """Return whether this process may be forked: Linux, and a single thread."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


class Fork:
    """A function of ours in a fork of this process; used like `Child`."""

    _ended: Ended | None = None

    def __init__(self, function: str, folder: Path, *, output: Path) -> None:
        order = {
            "function": function,
            "folder": str(folder),
            "output": str(output),
            "environment": child_environment(folder / TEMPORARY),
        }
        sys.stdout.flush()
        sys.stderr.flush()
        self._line, line = socket.socketpair()  # each side detects the end of the other
        self._pid = os.fork()
        if self._pid == 0:
            self._line.close()
            be_child(
                order, threading.Thread(target=_end_with, args=(line, folder), daemon=True).start
            )
        line.close()

    def wait(self, seconds: float) -> bool:
        """Wait at most this long [s]; return whether the fork ended."""
        return self._ended is not None or bool(
            select.select([self._line], [], [], max(0.0, seconds))[0]
        )

    def end(self) -> Ended:
        """End the fork; repeated calls return the same."""
        if self._ended is None:
            os.kill(self._pid, signal.SIGKILL)
            _, status, usage = os.wait4(self._pid, 0)
            code, cpu = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
            self._ended = Ended(code=code, cpu=cpu, memory=1024 * usage.ru_maxrss)
        return self._ended

    def close(self) -> None:
        """End the fork; its folder stays."""
        self.end()
        self._line.close()


def _end_with(line: socket.socket, folder: Path) -> None:
    """End this child with its parent, also while C code runs, and remove the folder."""
    line.recv(1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
