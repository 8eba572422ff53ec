"""What isolated children are asked to do in test_isolation.py: to behave, and to misbehave."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from models.errors import MachineError, UnknownNameError
from validate.processes.isolated import Ending, Limits, ModelFault, run_isolated

SLEEPER = [sys.executable, "-S", "-c", "import time; time.sleep(600)"]


def double(request, arrays):
    return {"given": request}, {"twice": 2 * arrays["x"]}


def says(request, arrays):
    libc = ctypes.CDLL(None)  # as an FMU prints: from C, without looking whether it succeeds
    for _ in range(2000):
        libc.puts(b'{"ending": "OK", "value": "garbage"}')
    libc.puts(b"\xff\xfe not UTF-8")
    libc.fflush(None)
    return "said"


def refuses(request, arrays):
    raise UnknownNameError("there is no such thing; choose another.")


def lacks(request, arrays):
    raise MachineError("there is no compiler.")


def finds_no_room(request, arrays):
    raise OSError(request, os.strerror(request))


def stumbles(request, arrays):
    raise KeyError("lost")


def hangs(request, arrays):
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        time.sleep(1)


def burns(request, arrays):
    while True:
        pass


def crashes(request, arrays):
    ctypes.string_at(0)


def aborts(request, arrays):
    os.abort()


def leaves(request, arrays):
    os._exit(int(request))


def fills(request, arrays):
    kept = []
    while True:
        kept.append(bytearray(64 * 1024**2))


def fatal(request, arrays):
    raise ModelFault(Ending.FATAL, "fmi2DoStep failed with status 4 (fatal)")


def nan(request, arrays):
    raise ModelFault(Ending.NOT_A_NUMBER, "x is nan at t = 0.1 s")


def nan_value(request, arrays):
    return float("nan")


def forks(request, arrays):
    if os.fork() == 0:
        os.setsid()
        os.execve(SLEEPER[0], SLEEPER, dict(os.environ))
    return "forked"


def comes_back_twice(request, arrays):
    return os.fork() if request else None


def crashes_after(request, arrays):
    import atexit

    atexit.register(ctypes.string_at, 0)
    return "done"


def writes_temporary_files(request, arrays):
    import tempfile

    with tempfile.NamedTemporaryFile(delete=False) as file:
        file.write(b"left")
    return file.name


def nested(request, arrays):
    """An isolated run within an isolated run, which hangs; both have started a process."""
    subprocess.Popen(SLEEPER)
    Path(request).write_text("started", encoding="utf-8")
    done = run_isolated("isolated_functions:starts_and_hangs", request, limits=Limits(seconds=60))
    return done.ending.name


def starts_and_hangs(request, arrays):
    subprocess.Popen(SLEEPER, start_new_session=True)
    Path(request).write_text("inner", encoding="utf-8")
    time.sleep(600)


def waits(request, arrays):
    Path(request).write_text(str(os.getpid()), encoding="utf-8")
    time.sleep(600)


def where(request, arrays):
    """What a fork shares with its parent, and what it does not."""
    import tempfile

    return [
        os.getppid(), os.getsid(0) == os.getpid(), tempfile.gettempdir(), os.getcwd(),
        os.read(0, 1).decode(),
        "isolated_functions" in sys.modules,
    ]  # fmt: skip


def sums(request, arrays):
    return float(np.sum(arrays["x"]))


def calls(request, arrays):
    library, name = request
    getattr(ctypes.CDLL(library), name)()
    return "came back"


MADE = []


def counts(request, arrays):
    """How many calls its process has had; what is asked for may end it."""
    MADE.append(request)
    if request == "crash" or (request == "crash if not first" and len(MADE) > 1):
        crashes(request, arrays)
    if request == "hang":
        time.sleep(600)
    if request == "refuse":
        raise UnknownNameError("no.")
    return len(MADE), arrays
