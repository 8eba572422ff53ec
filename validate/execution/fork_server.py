"""A process that has imported what cells need, and forks one child a cell: a cell begins in milliseconds instead of a second.

    with fork_server(cells) as server:
        child = server.start(folder, token=token, temporary=folder / "tmp", log=folder / "log.txt")     # as validate.execution.process's ChildProcess

Run as a module, this file is that process. It does what it is told on its standard input, a line of JSON at a time, and nothing else:

    {"modules": [..], "cell": "validate.execution.child:main"}  ->  {"threads": 1}          {"start": {..}}  ->  {"pid": 123}
    {"reap": 123}  ->  {"status": 0, "cpu": 1.5, "memory": 100000000}

A child is a cell like any other: it has a session, a log, a folder and a token of its own, and dies with the server, which dies with the campaign. Its
token is written over that of the server's in the environment that the system shows, so that whoever ends the cell finds it. The server has one
thread and never runs a cell's code, so there is nothing that a fork could cut in two. Linux only: elsewhere, and where a library has
started threads, cells are started one by one.

The standard library's forkserver starts a child in the same time (12 to 50 ms on a busy machine, ours 23 to 50). It reaps the child itself, at once,
and tells an exit code alone: what a cell that crashed or was killed has cost in CPU time and memory would be lost, and its number could be
another's before its family is ended.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from validate.execution.isolated_child import die_with_parent
from validate.execution.process import PARENT_VARIABLE, ChildProcess, Ended, child_environment, end_family, interrupts_wait
from validate.execution.reaper import TOKEN_VARIABLE

# What most cells import.
MODULES = (
    *("numpy", "scipy.sparse.linalg", "scipy.linalg", "scipy.special", "sympy", "pyomo.environ", "h5netcdf", "psutil", "fmpy"),
    *(
        "validate.execution.child",
        "validate.tasks.run",
        "validate.tasks.records",
        "validate.tasks.scene_record",
        "validate.tasks.plugins",
        "validate.judge.score",
        "validate.judge.replay.run",
    ),
    *("models.catalog", "models.scene.checks", "models.codegen.kernel", "models.fmu", "models.trajectory_netcdf"),
    *("reports.records.check_record", "formulations.mpec", "formulations.ipopt", "formulations.transcription.strict"),
    *("formulations.contact_modes.session", "formulations.multiple_shooting.session"),
)
# What one cell in four imports, in 3 CPU s and half a gigabyte that all children then share: PyTorch, and what its optimisers import at their first
# use (1.1 s). Worth it from so many cells on.
TORCH_MODULES, TORCH_WORTH = ("formulations.shooting.session", "torch._dynamo"), 20
# Longest folder that is shown in a child's environment; a longer one only the child itself knows.
_LONGEST = 1000
_TOKEN = "0" * 32
# From so many cells on the server has saved the time of its own start.
WORTH = 4


class ForkServerError(Exception):
    """The server cannot be used here; cells are then started one by one."""


class ForkServer:
    """See the module docstring. modules: imported beforehand; cell: the function that is given the folder. Raises ForkServerError if there can
    be none."""

    def __init__(self, modules: Sequence[str] = MODULES, cell: str = "validate.execution.child:main") -> None:
        if sys.platform != "linux" or not hasattr(os, "pidfd_open"):
            raise ForkServerError("only Linux tells the end of a process that is not one's own child")
        placeholder = Path("/" + "x" * (_LONGEST - 1))
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "validate.execution.fork_server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=child_environment(_TOKEN, placeholder) | {TOKEN_VARIABLE: _TOKEN},
            start_new_session=True,
            text=True,
        )
        try:
            if os.environ.get(TOKEN_VARIABLE):
                raise ForkServerError("a cell in a cell carries two tokens")
            if self.ask({"modules": modules, "cell": cell})["threads"] != 1:
                raise ForkServerError("a library has started threads")
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to a request; Ctrl-C waits for it, or the next would have the answer of this. Raises ForkServerError if the server is gone."""
        stdin, stdout = self._process.stdin, self._process.stdout
        if stdin is None or stdout is None:
            raise ForkServerError("the server has no pipes")
        try:
            with interrupts_wait():
                stdin.write(json.dumps(request) + "\n")
                stdin.flush()
                answer = stdout.readline()
            return json.loads(answer)
        except (OSError, ValueError) as error:
            raise ForkServerError("the server is gone") from error

    def start(self, folder: Path, *, token: str, temporary: Path, log: Path) -> ForkedChild:
        """The child that runs the cell of a folder. Raises ForkServerError, OSError."""
        told = {"folder": str(folder), "token": token, "temporary": str(temporary), "log": str(log)}
        return ForkedChild(self, self.ask({"start": told})["pid"], token)

    def close(self) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


class ForkedChild(ChildProcess):
    """A running cell whose parent is the server. Its number is not given to another before it is reaped."""

    def __init__(self, server: ForkServer, pid: int, token: str) -> None:
        self._server, self.pid, self.token = server, pid, token
        self._family = {}
        self._handle = os.pidfd_open(pid)
        self._ended: Ended | None = None

    def has_ended(self) -> bool:
        return bool(select.select([self._handle], [], [], 0.0)[0])

    def wait(self, seconds: float) -> bool:
        return bool(select.select([self._handle], [], [], max(0.0, seconds))[0])

    def end(self) -> Ended:
        """End the child and all it started, wherever they went; once more, it says the same."""
        with interrupts_wait():
            if self._ended is None:
                self._ended = self._end()
        return self._ended

    def _end(self) -> Ended:
        self.look()
        strays = end_family(self.token, self.pid, self._family)
        select.select([self._handle], [], [])
        os.close(self._handle)
        try:
            told = self._server.ask({"reap": self.pid})
        except ForkServerError:  # then they died with it
            told = {"status": -9, "cpu": 0.0, "memory": 0}
        return Ended(code=told["status"], cpu=told["cpu"], memory=told["memory"], strays=strays)


def modules_for(cells: int) -> Sequence[str]:
    """What a server imports for so many cells."""
    return (*MODULES, *TORCH_MODULES) if cells >= TORCH_WORTH else MODULES


@contextlib.contextmanager
def fork_server(cells: int) -> Iterator[ForkServer | None]:
    """A server for so many cells, or None where there can be none, or it would cost more than it saves."""
    try:
        server = ForkServer(modules_for(cells)) if cells >= WORTH else None
    except ForkServerError:
        server = None
    try:
        yield server
    finally:
        if server is not None:
            server.close()


def _serve() -> None:
    """The server: see the module docstring."""
    die_with_parent()
    shown = {name: _shown(name) for name in (TOKEN_VARIABLE, "TMPDIR")}
    os.environ[PARENT_VARIABLE] = str(os.getpid())
    cell = ""
    for line in sys.stdin:
        request = json.loads(line)
        if "start" in request:
            answer = {"pid": _fork(request["start"], shown, cell)}
        elif "reap" in request:
            _, status, usage = os.wait4(request["reap"], 0)
            answer = {"status": os.waitstatus_to_exitcode(status), "cpu": usage.ru_utime + usage.ru_stime, "memory": usage.ru_maxrss * 1024}
        else:
            cell = request["cell"]
            _prepare(request["modules"])
            answer = {"threads": len(os.listdir("/proc/self/task"))}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


def _prepare(modules: Sequence[str]) -> None:
    for name in modules:
        with contextlib.suppress(ImportError):  # an extra that is not installed, or what a cell will say itself
            importlib.import_module(name)
    gc.collect()
    gc.freeze()  # so that what is shared stays shared when a child looks for garbage


def _fork(told: dict[str, str], shown: dict[str, tuple[int, int]], cell: str) -> int:
    """Number of the child, which by then has its own session and shows its own token."""
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        os.read(reader, 1)
        os.close(reader)
        return child
    try:
        os.setsid()
        _show(shown[TOKEN_VARIABLE], told["token"])
        _show(shown["TMPDIR"], told["temporary"])
        os.write(writer, b".")
        os.close(writer)
        os.close(reader)
        os.environ.update({TOKEN_VARIABLE: told["token"], "TMPDIR": told["temporary"]})
        tempfile.tempdir = None
        nothing, log = os.open(os.devnull, os.O_RDONLY), os.open(told["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        os.dup2(nothing, 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.close(nothing)
        os.close(log)
        os.chdir(told["temporary"])
        from validate.execution.child import run

        module, _, name = cell.partition(":")
        run(getattr(importlib.import_module(module), name), Path(told["folder"]))
    finally:
        os._exit(1)


def _shown(name: str) -> tuple[int, int]:
    """(address, room) of a variable's value where the system reads this process's environment; valid while nobody has set it anew."""
    getenv = ctypes.CDLL(None).getenv
    getenv.restype, getenv.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    return getenv(name.encode()), len(os.fsencode(os.environ[name]))


def _show(place: tuple[int, int], text: str) -> None:
    """Write a value over the one that is shown."""
    address, room = place
    ctypes.memmove(address, os.fsencode(text)[:room].ljust(room, b"\0"), room)


if __name__ == "__main__":
    _serve()
