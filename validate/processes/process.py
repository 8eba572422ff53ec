"""A child process under a supervisor (validate.processes.supervisor): started, watched, and ended with everything it started. Tasks and isolated FMUs use the same.

# calls main(folder) there
child = Child("validate.tasks.child:main", folder, output=folder / "log.txt")
while not child.wait(0.05): ...
ended = child.end()                 # how, what it cost; no process of it is left
child.close()                       # and no folder

Every child process is given one thread for every library, no hash randomisation, and temporary
files in its own folder. What must not be cut short by Ctrl-C: it is held back for a moment, and
heard then.

Code of our own may run in a fork of this process instead, which has imported already what it needs:
that takes a third of a replay.

    if can_fork():
        child = Fork("module:main", folder, output=folder / "output.txt")    # used like a Child

Foreign code gets a process of its own under a supervisor, which finds whatever it starts; here
nothing is looked for. When this process is killed, the fork removes its folder and ends.
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

# What ends a campaign in words: Ctrl-C, a polite kill, a closed terminal.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """What would raise KeyboardInterrupt raises it when the block has ended.

    The second of them at once. Outside the main thread nothing is held back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []

    def hear(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        if len(heard) > 1:
            signal.default_int_handler(number, frame)

    mine = [number for number in ENDING if signal.getsignal(number) is signal.default_int_handler]
    for number in mine:
        signal.signal(number, hear)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.default_int_handler)
    if heard:
        raise KeyboardInterrupt


ROOT = Path(__file__).resolve().parents[2]
# In the folder of a child.
TEMPORARY = "tmp"
# One thread for every library of a child: times compare, sums are added in one order, and -j N uses
# N cores.
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
    """Cores this process may use, which in a container are fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def child_environment(temporary: Path | None = None) -> dict[str, str]:
    """The environment of a process that we start. temporary: its folder for temporary files, if not ours."""
    given = [
        str(Path(part).resolve())
        for part in os.environ.get("PYTHONPATH", "").split(os.pathsep)
        if part
    ]
    # What the parent can import because it was started with `python -m`, the child can import too.
    here = [os.getcwd()] if {"", os.getcwd()} & set(sys.path) else []
    return {
        **os.environ,
        **dict.fromkeys(_THREAD_VARIABLES, str(THREADS)),
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *given, *here]),
        **({} if temporary is None else {"TMPDIR": str(temporary)}),
    }


def _start_supervisor(
    channel: socket.socket, environment: Mapping[str, str], modules: Sequence[str] = ()
) -> subprocess.Popen[bytes]:
    """The process at the other end of a channel. Raises MachineError."""
    # -P: the folder it runs in is not searched for modules.
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
            f"a process cannot be started ({error.strerror}); end what is not needed."
        ) from error


class Preloaded:
    """A process that has imported what children need, and from which their supervisors are forked: a child then begins in milliseconds instead of a second.

    Linux only. Raises MachineError where there can be none: a library has started threads in it, or
    it cannot be started.
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
        """Have a supervisor at the other end of a channel.

        Whether there is one: somebody may have ended this process.
        """
        with contextlib.suppress(OSError):
            socket.send_fds(self._channel, [b"f"], [channel.fileno()])
            return self._process.poll() is None
        return False

    def close(self) -> None:
        """End the process; the supervisors that it forked live on."""
        self._process.kill()
        self._process.wait()
        self._channel.close()


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a child ended and what it cost.

    code: its exit code, negative for a signal; strays: how many processes it left behind, all
        ended; cpu [s]: of the child and those it waited for;
    memory: its largest resident size [bytes]; space: its largest address space [bytes], 0 where it
        is not known.
    """

    code: int
    strays: int = 0
    cpu: float = 0.0
    memory: int = 0
    space: int = 0


class KeptFolder:
    """A folder that is gone once it is closed, or we have ended, in whatever way.

    Its name begins with `.partial-`. Raises MachineError.
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
        asked = json.dumps(
            {"folder": str(folder), "environment": environment, **(order or {})}
        ).encode()
        with contextlib.suppress(OSError):  # somebody has ended it: the child has ended then
            self._channel.sendall(LENGTH.pack(len(asked)) + asked)

    def close(self) -> None:
        """Remove it. Returns when the supervisor has ended too."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._channel.shutdown(socket.SHUT_WR)
            while self._channel.recv(ENDED.size):
                pass
        self._channel.close()
        if self._supervisor is not None:
            self._supervisor.wait()


class Child(KeptFolder):
    """A function of ours at work in a process of its own; see the module docstring.

    Raises MachineError.

    function: `module:name`; folder: what it is given, where TEMPORARY is for its temporary files;
        output: where what it prints goes; preloaded: what
    its supervisor is forked from.
    """

    _ended: Ended | None = None

    def __init__(
        self, function: str, folder: Path, *, output: Path, preloaded: Preloaded | None = None
    ) -> None:
        super().__init__(folder, {"function": function, "output": str(output)}, preloaded)

    def wait(self, seconds: float) -> bool:
        """Wait at most that long [s]; whether it ended."""
        if self._ended is None and select.select([self._channel], [], [], max(0.0, seconds))[0]:
            self._ended = self._hear()
        return self._ended is not None

    def end(self) -> Ended:
        """End the child and all it started, wherever they went; once more, it says the same."""
        if self._ended is None:
            with contextlib.suppress(OSError):
                self._channel.send(b"e")
            self._ended = self._hear()
        return self._ended

    def _hear(self) -> Ended:
        said = b""
        with contextlib.suppress(OSError):
            said = self._channel.recv(ENDED.size, socket.MSG_WAITALL)
        if len(said) == ENDED.size:
            code, strays, cpu, memory, space = ENDED.unpack(said)
            return Ended(code=code, strays=strays, cpu=cpu, memory=memory, space=space)
        return Ended(code=-signal.SIGKILL, strays=_end_users_of(self._folder))

    def close(self) -> None:
        """End it, and remove its folder."""
        self.end()
        super().close()


def _end_users_of(folder: Path) -> int:
    """End the processes of a child whose supervisor was killed, and which died with it: those whose temporary files lie in its folder; how many."""
    import psutil  # 0.05 s

    found = 0
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if Path(process.environ().get("TMPDIR", "/")).is_relative_to(folder):
                process.kill()
                found += 1
    return found


def exit_in_words(code: int) -> str:
    """`exit code 3` or `signal 11 (SIGSEGV)`."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"signal {-code}"


def can_fork() -> bool:
    """Whether this process may be forked: on Linux, and with one thread, as another would be cut off amid its work."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


class Fork:
    """See the module docstring; used like `Child`."""

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
        self._line, line = socket.socketpair()  # each side hears the end of the other
        self._pid = os.fork()
        if self._pid == 0:
            self._line.close()
            be_child(
                order, threading.Thread(target=_end_with, args=(line, folder), daemon=True).start
            )
        line.close()

    def wait(self, seconds: float) -> bool:
        """Wait at most that long [s]; whether it ended."""
        return self._ended is not None or bool(
            select.select([self._line], [], [], max(0.0, seconds))[0]
        )

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


def _end_with(line: socket.socket, folder: Path) -> None:
    """In the child: wait for the end of its parent, whatever C code runs beside, and leave nothing."""
    line.recv(1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
