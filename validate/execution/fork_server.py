"""Tasks as forks of one process that has imported what they need: a task begins in milliseconds instead of a second.

    server = start_fork_server(tasks)
    child = server.start(folder, token=token, temporary=folder / "tmp", log=folder / "log.txt")     # as validate.execution.process's ChildProcess

The server is that of the standard library, `multiprocessing.forkserver`, one for each campaign: it has then imported the sources as they are now. What it
reads of a child is no `multiprocessing.Process` but `_Child`: nobody's `__main__` is imported in it, and a daemon (a Dask worker) may start it.

A child is a task like any other: it has a session, a log, a folder and a token of its own, and dies with the server, which dies with the campaign. Its
token is written over that of the server's in the environment that the system shows, so that whoever ends the task finds it, and what it forks. The
server reaps a child at once and tells its exit code alone: what it cost is what it had cost at the last look. Linux only: elsewhere, and where a
library has started threads, tasks are started one by one.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import multiprocessing.util
import os
import pickle
import select
import signal
import sys
import tempfile
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import psutil

from validate.execution.child import run_and_exit
from validate.execution.isolated_child import die_with_parent
from validate.execution.process import (
    PARENT_VARIABLE,
    ChildProcess,
    Ended,
    ForkServerError,
    child_environment,
    end_family,
    shared_watchdog,
)
from validate.execution.reaper import TOKEN_VARIABLE

# What most tasks import.
MODULES = (
    *("numpy", "scipy.sparse.linalg", "scipy.linalg", "scipy.special", "sympy", "pyomo.environ", "h5netcdf", "psutil", "fmpy"),
    *(
        "validate.execution.child",
        "validate.tasks.path",
        "validate.judge.score",
        "validate.judge.replay.run",
    ),
    *("models.catalog", "models.scene.checks", "models.codegen.kernel", "models.fmu", "models.trajectory_netcdf"),
    *("reports.records.check_record", "formulations.mpec", "formulations.ipopt", "formulations.transcription.homotopy"),
    *("formulations.contact_modes.session", "formulations.multiple_shooting.method"),
)
# What one task in four imports, in 3 CPU s and half a gigabyte that all children then share: PyTorch, and what its optimisers import at their first
# use (1.1 s). Worth it from so many tasks on.
TORCH_MODULES, TORCH_WORTH = ("formulations.shooting.session", "torch._dynamo"), 20
# From so many tasks on the server has saved the time of its own start.
WORTH = 4
# What a server is to import; only a server has it.
_PRELOAD_VARIABLE = "TOUCHSTONE_PRELOAD"
# What a server's environment shows where a child writes its own. A longer folder than that only the child itself knows.
_TOKEN, _TEMPORARY = "0" * 32, Path("/" + "x" * 999)


class _Server(multiprocessing.forkserver.ForkServer):
    """The library's, which is started once: it would start a server that died anew, in the environment of that moment."""

    _begun = False

    def ensure_running(self) -> None:
        if not self._begun:
            self._begun = True
            super().ensure_running()

    def end(self) -> None:
        """Not when it has imported everything, and nothing holds its pipe any more: at once, and its children with it."""
        pid: int | None = self._forkserver_pid  # pyright: ignore[reportAttributeAccessIssue] - the library has no word for it
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
            self._stop()  # pyright: ignore[reportAttributeAccessIssue] - as above


class ForkServer:
    """See the module docstring.

    modules: imported beforehand; task: the function that is given the folder. Raises ForkServerError if there can be none.
    """

    def __init__(self, modules: Sequence[str] = MODULES, task: str = "validate.execution.child:main") -> None:
        if sys.platform != "linux":
            raise ForkServerError("only Linux shows, and lets change, the environment of a process")
        if os.environ.get(TOKEN_VARIABLE):
            raise ForkServerError("a task in a task carries two tokens")
        self._task, self._environment, self._server = task, child_environment("", Path()), _Server()
        self._server.set_forkserver_preload([__name__])
        # The library's folder for the server's socket; it removes it, if it comes to that.
        self._mark = uuid.uuid4().hex
        shared_watchdog().tell("start", self._mark, multiprocessing.util.get_temp_dir())
        environment = child_environment(_TOKEN, _TEMPORARY) | {_PRELOAD_VARIABLE: ",".join(modules), "PYTHONSAFEPATH": "1"}
        try:
            with terminal_blocked(), _changed_environment(environment):
                self._server.ensure_running()
            self._wait_until_ready()
        except (OSError, EOFError) as error:
            self.close()
            raise ForkServerError("the server cannot be started, or a library has started threads in it") from error
        except BaseException:
            self.close()
            raise

    def _wait_until_ready(self) -> None:
        """Until it forks a child, which reads nothing and ends. Whoever starts the first that matters has no time to lose, and hears no Ctrl-C."""
        state, pipe = self._server.connect_to_new_process([])
        os.close(pipe)
        with open(state, "rb"):
            multiprocessing.forkserver.read_signed(state)

    def start(self, folder: Path, *, token: str, temporary: Path, log: Path) -> ForkedChild:
        """The child that runs the task of a folder. Raises ForkServerError."""
        environment = self._environment | {TOKEN_VARIABLE: token, "TMPDIR": str(temporary)}
        # The first is what multiprocessing would prepare, its parent's __main__ above all: nothing.
        orders = pickle.dumps({}) + pickle.dumps(_Child(self._task, folder, log, environment))
        try:
            return ForkedChild(*self._server.connect_to_new_process([]), orders, token)
        except (OSError, EOFError) as error:
            raise ForkServerError("the server is gone") from error

    def close(self) -> None:
        """End the server, and its children with it."""
        self._server.end()
        shared_watchdog().tell("stop", self._mark)


class ForkedChild(ChildProcess):
    """A running task whose parent is the server.

    state: where the server writes its number, and its exit code once it is reaped; pipe: where it reads what it is to do. Raises OSError, EOFError if
    the server is gone.
    """

    def __init__(self, state: int, pipe: int, orders: bytes, token: str) -> None:
        self._state, self.token, self._family = state, token, {}
        try:
            with open(pipe, "wb") as file:
                file.write(orders)
            self.pid = multiprocessing.forkserver.read_signed(state)
        except BaseException:
            os.close(state)
            raise
        self._cpu, self._memory = 0.0, 0
        try:
            self._living = psutil.Process(self.pid)
        except psutil.Error:  # it has ended
            self._living = None
        self.look()

    def has_ended(self) -> bool:
        """Whether the child ended."""
        return self.wait(0.0)

    def wait(self, seconds: float) -> bool:
        """Wait at most that long [s]; whether it ended."""
        return self._ended is not None or bool(select.select([self._state], [], [], max(0.0, seconds))[0])

    def look(self) -> None:
        """Remember what it has started and cost by now: of a child that has ended the server knows neither."""
        if self._living is not None and self._living.is_running():
            super().look()
            with contextlib.suppress(psutil.Error):
                self._memory = max(self._memory, self._living.memory_info().rss)
                self._cpu = sum(self._living.cpu_times()[:4])

    def _end(self) -> Ended:
        self.look()
        if self._living is not None:
            with contextlib.suppress(psutil.Error):
                self._living.kill()  # so early, it may have neither session nor token
        strays = end_family(self.token, self.pid if self._has_number() else None, self._family)
        try:
            code = multiprocessing.forkserver.read_signed(self._state)
        except EOFError:  # the server is gone, and its children went with it
            code = -signal.SIGKILL
        os.close(self._state)
        return Ended(code=code, cpu=self._cpu, memory=self._memory, strays=strays)

    def _has_number(self) -> bool:
        """Whether its number is still its own: that of its group, if it is reaped. The system gives no number away while a group has it."""
        return not psutil.pid_exists(self.pid) or (self._living is not None and self._living.is_running())


@dataclass(frozen=True)
class _Child:
    """What a fork of the server is to do. multiprocessing has it read there, in place of a Process, and calls its `_bootstrap`."""

    task: str
    folder: Path
    log: Path
    environment: dict[str, str]

    def _bootstrap(self, _parent_sentinel: int) -> NoReturn:
        try:
            os.setsid()
            signal.pthread_sigmask(signal.SIG_SETMASK, ())
            for name in (TOKEN_VARIABLE, "TMPDIR"):
                _show(name, self.environment[name])
            for name in os.environ.keys() - self.environment.keys():
                del os.environ[name]
            os.environ.update(self.environment | {PARENT_VARIABLE: str(_SERVER)})
            tempfile.tempdir = None
            sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - the library has left it with another number
            log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.close(log)
            os.chdir(self.environment["TMPDIR"])
            module, _, name = self.task.partition(":")
            run_and_exit(getattr(importlib.import_module(module), name), self.folder)
        finally:
            os._exit(1)


def start_fork_server(tasks: int) -> ForkServer | None:
    """A server for so many tasks, or None where there can be none, or it would cost more than it saves."""
    if tasks < WORTH:
        return None
    with contextlib.suppress(ForkServerError):
        return ForkServer((*MODULES, *TORCH_MODULES) if tasks >= TORCH_WORTH else MODULES)
    return None


@contextlib.contextmanager
def terminal_blocked() -> Iterator[None]:
    """Threads and processes started meanwhile, and what these ever start, do not hear Ctrl-C and a closed terminal: those are for us."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    multiprocessing.resource_tracker.ensure_running()  # it would lift the mask when it is started later
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _changed_environment(given: Mapping[str, str]) -> Iterator[None]:
    """What is started meanwhile has this environment: multiprocessing takes none."""
    before = {name: os.environ.get(name) for name, value in given.items() if os.environ.get(name) != value}
    os.environ.update(given)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _show(name: str, text: str) -> None:
    """Write a variable's value over the one that the system shows of this process, as far as there is room: nobody has set it anew by now."""
    getenv = ctypes.CDLL(None).getenv
    getenv.restype, getenv.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    room = len(os.fsencode(os.environ[name]))
    ctypes.memmove(getenv(name.encode()), os.fsencode(text)[:room].ljust(room, b"\0"), room)


def _prepare(modules: Sequence[str]) -> None:
    """What the server does before its first child: it leaves the terminal, and imports."""
    os.setsid()
    die_with_parent()
    nothing = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(nothing, standard)
    os.close(nothing)
    for name in modules:
        with contextlib.suppress(ImportError):  # an extra that is not installed, or what a task will say itself
            importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:  # a fork would cut a library's threads in two
        os._exit(1)
    gc.collect()
    gc.freeze()  # so that what is shared stays shared when a child looks for garbage


_SERVER = os.getpid()
if _PRELOAD_VARIABLE in os.environ:
    _prepare(os.environ.pop(_PRELOAD_VARIABLE).split(","))
