"""What a child process does first: die with its parent, leave no core file, stay within its limits."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

from validate.isolation.environment import PARENT_VARIABLE


def die_with_parent() -> None:
    """Linux: be killed when the parent dies (PR_SET_PDEATHSIG); elsewhere the parent's watchdog does it."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL, 0, 0, 0)
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is not None and os.getppid() != int(parent):
        os._exit(1)  # it died before we could ask


def limit_resources(*, file_bytes: int, memory_bytes: int | None = None, cpu_seconds: float | None = None) -> None:
    """No core file, no file larger than that; address space and CPU time where given. Limits that are narrower already stay."""
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
