"""What a child process does first: die with its parent, leave no core file, stay within its limits, and tell why it crashes if it was for memory."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import sys
from pathlib import Path
from typing import Any

from validate.isolation.environment import PARENT_VARIABLE

# Of prctl.
_PARENT_DEATH_SIGNAL, _CHILD_SUBREAPER = 1, 36


def die_with_parent() -> None:
    """Linux: be killed when the parent dies (PR_SET_PDEATHSIG); elsewhere the parent's watchdog does it."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is not None and os.getppid() != int(parent):
        os._exit(1)  # it died before we could ask


def adopt_orphans() -> None:
    """Linux: what this process starts stays below it, whatever sessions and environments it makes for itself, so that it can be found."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)


# No module's bytecode is larger [bytes].
_ANY_BYTECODE = 16 * 1024**2


def limit_resources(*, file_bytes: int, memory_bytes: int | None = None, cpu_seconds: float | None = None) -> None:
    """No core file, no file larger than that; address space and CPU time where given. Limits that are narrower already stay.

    Under a narrow limit no bytecode is written: Python would write what fits, and every later process would stumble over it.
    """
    if file_bytes < _ANY_BYTECODE:
        sys.dont_write_bytecode = True
    try:
        import resource
    except ImportError:  # not on Windows
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    wanted = {
        resource.RLIMIT_FSIZE: file_bytes,
        resource.RLIMIT_AS: memory_bytes,
        resource.RLIMIT_CPU: None if cpu_seconds is None else int(cpu_seconds) + 1,
    }
    for kind, limit in wanted.items():
        soft, hard = resource.getrlimit(kind)
        if limit is not None and (soft == resource.RLIM_INFINITY or soft > limit):
            resource.setrlimit(kind, (limit, hard))


def mark_refused_memory(mark: Path) -> Any:
    """Let a crash that follows a refused allocation leave the file `mark`: C code that does not look at what malloc gave writes to address 0.

    Then errno is still ENOMEM. The handler runs as Python, which it can where C code was called through ctypes, as FMUs are; it puts the former handler
    back and returns, so that the crash goes on as it would have. What is returned must be kept as long as the process lives.
    """
    if sys.platform == "win32":
        return None
    signals = (signal.SIGSEGV, signal.SIGBUS)
    set_handler: Any = ctypes.CDLL(None).signal
    set_handler.restype, set_handler.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    former: dict[int, Any] = {}

    def on_crash(number: int) -> None:
        set_handler(number, former[number])
        if ctypes.get_errno() == errno.ENOMEM:
            os.close(os.open(mark, os.O_CREAT | os.O_WRONLY, 0o600))

    handler = ctypes.CFUNCTYPE(None, ctypes.c_int, use_errno=True)(on_crash)
    for number in signals:
        former[number] = set_handler(number, ctypes.cast(handler, ctypes.c_void_p))
    return handler
