"""A child process in a session of its own: started, watched, and ended with everything it started. Tasks and isolated FMUs use the same.

child = ChildProcess("validate.execution.child", [str(folder)], token=token, temporary=folder / "tmp", output=log)
while not child.has_ended(): ...
ended = child.end()                 # how, what it cost; no process of it is left

What must not be cut short by Ctrl-C: it is held back for a moment, and heard then.

What every child process is given: one thread for every library, no hash randomisation, temporary files in its own folder.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import IO, Any

from validate.execution import reaper
from validate.execution.reaper import TOKEN_VARIABLE

# What ends a campaign in words: Ctrl-C, a polite kill, a closed terminal.
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """What would raise KeyboardInterrupt raises it when the block has ended; the second of them at once. Outside the main thread nothing is held back."""
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
# One thread for every library of a child: times compare, sums are added in one order, and -j N uses N cores.
THREADS = 1
PARENT_VARIABLE = "TOUCHSTONE_PARENT"
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


def child_environment(token: str, temporary: Path) -> dict[str, str]:
    """The environment of a child that carries a token. A child of a child carries both, so that whoever ends the outer ends the inner."""
    given = [str(Path(part).resolve()) for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part]
    # What the parent can import because it was started with `python -m`, the child can import too.
    here = [os.getcwd()] if {"", os.getcwd()} & set(sys.path) else []
    return {
        **os.environ,
        **dict.fromkeys(_THREAD_VARIABLES, str(THREADS)),
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *given, *here]),
        "TMPDIR": str(temporary),
        PARENT_VARIABLE: str(os.getpid()),
        TOKEN_VARIABLE: ",".join(filter(None, [os.environ.get(TOKEN_VARIABLE, ""), token])),
    }


class ForkServerError(Exception):
    """There is no fork server here, or no more (validate.execution.fork_server); tasks are then started one by one."""


# Pause between two looks where the system cannot tell us the end of a process [s].
_LOOK = 0.01
# How often, and how long apart [s], we look whether what was killed is gone: 10 s, on the busiest machine.
_ROUNDS, _PAUSE = 1000, 0.01


class Watchdog:
    """The process that tidies up after us if we are killed (validate.execution.reaper)."""

    def __init__(self) -> None:
        command = [sys.executable, "-I", "-S", reaper.__file__]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            bufsize=0,  # one write a line: threads do not mix theirs
        )

    def tell(self, *words: str) -> None:
        """Say `start TOKEN FOLDER` or `stop TOKEN`."""
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(os.fsencode(" ".join(words) + "\n"))

    @property
    def lives(self) -> bool:
        """Whether nobody has ended it."""
        return self._process.poll() is None

    def close(self) -> None:
        """Have it tidy up, and wait for it."""
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        self._process.wait()


@lru_cache(maxsize=1)
def _watchdog_of(process: int) -> Watchdog:
    dog = Watchdog()
    atexit.register(dog.close)
    return dog


def shared_watchdog() -> Watchdog:
    """One watchdog for all isolated runs of this process (another one after a fork, or if somebody ended it)."""
    dog = _watchdog_of(os.getpid())
    if not dog.lives:
        _watchdog_of.cache_clear()
        dog = _watchdog_of(os.getpid())
    return dog


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a child ended and what it cost.

    code: its exit code, negative for a signal; cpu [s]: of the child and those it waited for; memory: its largest resident one [bytes]; strays: how many
    processes it left behind, all ended.
    """

    code: int
    cpu: float
    memory: int
    strays: int


class ChildProcess:
    """One running Python module; see the module docstring."""

    _ended: Ended | None = None

    def __init__(self, module: str, arguments: Sequence[str], *, token: str, temporary: Path, output: IO[bytes]) -> None:
        self.token = token
        # -P: the folder the child runs in is not searched for modules.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=temporary,
            env=child_environment(token, temporary),
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._family: dict[int, str] = {}  # number -> when it was started, which tells it from a later process of that number

    def has_ended(self) -> bool:
        """Whether the child ended. It is looked at without being waited for: until then its group's number cannot be given to another."""
        if not hasattr(os, "waitid"):  # macOS before Python 3.13
            return self._process.poll() is not None
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def wait(self, seconds: float) -> bool:
        """Wait at most that long; whether it ended."""
        if hasattr(os, "pidfd_open"):
            with contextlib.suppress(OSError):
                handle = os.pidfd_open(self.pid)
                try:
                    select.select([handle], [], [], max(0.0, seconds))
                finally:
                    os.close(handle)
                return self.has_ended()
        until = time.monotonic() + seconds
        while not self.has_ended():
            left = until - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(_LOOK, left))
        return True

    def address_space(self) -> int:
        """Largest address space so far [bytes]; 0 where it is not known."""
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self.pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
                if line.startswith("VmPeak:"):
                    return 1024 * int(line.split()[1])
        return 0

    def look(self) -> None:
        """Remember what the child has started by now: a daemon may leave its group and empty its environment, but not the family."""
        for number in _descendants(self.pid):
            self._family.setdefault(number, _started(number))

    def end(self) -> Ended:
        """End the child and all it started, wherever they went; once more, it says the same."""
        if self._ended is None:
            self._ended = self._end()
        return self._ended

    def _end(self) -> Ended:
        self.look()
        strays = end_family(self.token, self.pid, self._family)
        if self._process.returncode is not None or not hasattr(os, "wait4"):
            return Ended(code=self._process.wait(), cpu=0.0, memory=0, strays=strays)
        _, status, usage = os.wait4(self.pid, 0)
        self._process.returncode = os.waitstatus_to_exitcode(status)
        return Ended(code=self._process.returncode, cpu=usage.ru_utime + usage.ru_stime, memory=_bytes(usage), strays=strays)


def end_family(token: str, child: int | None, family: Mapping[int, str]) -> int:
    """End a child and all it started; how many were left beside it.

    family: when each of its descendants was started (`ChildProcess.look`); child: its number, None if that is another's by now. Returns when none of them lives any more: a killed process goes on for as long as a busy machine lets it wait for its end.
    """
    strays = reaper.end_all(token, child) - {child}
    for _ in range(_ROUNDS):
        living = [number for number, began in family.items() if began and number != child and _started(number) == began]
        strays.update(living)
        if not living:
            break
        for number in living:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(number, signal.SIGKILL)
        time.sleep(_PAUSE)
    return len(strays)


def _descendants(parent: int) -> list[int]:
    """Linux: the children of a process that lives, and theirs.

    psutil reads the whole table of processes for that: 7 ms instead of 0.3, 50 times a second, and 50 ms to import in every isolated child.
    """
    found = []
    with contextlib.suppress(OSError, ValueError):
        for task in Path(f"/proc/{parent}/task").iterdir():
            for number in map(int, (task / "children").read_text(encoding="ascii").split()):
                found += [number, *_descendants(number)]
    return found


def _started(process: int) -> str:
    """When a living process was started, in the system's ticks; empty if it is gone or a zombie."""
    with contextlib.suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return "" if fields[0] in "ZX" else fields[19]
    return ""


def _bytes(usage: Any) -> int:
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def exit_in_words(code: int) -> str:
    """`exit code 3` or `signal 11 (SIGSEGV)`."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"signal {-code}"
