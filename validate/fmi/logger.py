"""The logger of FMI 2.0: it formats a message with its arguments, in C.

    logger, environment, kept = made(lambda text: print(text.decode()))

A callback of ctypes has no variable arguments: it cannot format "cannot open %s".
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from fmpy import fmi2

from models.codegen.compiler import cached_library
from models.errors import MachineError

_SOURCE = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")
_SINK = ctypes.CFUNCTYPE(None, ctypes.c_char_p)
# Sinks that logger.c may call: its last INSTANCES.
_living: deque[Any] = deque(maxlen=64)


@cache
def _library() -> Any:
    """Return the compiled logger, None on a machine that cannot build or load it."""
    try:
        return ctypes.CDLL(str(cached_library({"logger.c": _SOURCE})))
    except (MachineError, OSError):
        return None


def made(say: Callable[[bytes | None], None]) -> tuple[Any, int | None, Any]:
    """Return a logger: the callback, its environment, and an object to keep while it is used.

    Without a compiler the messages lack their arguments.
    """
    library = _library()
    if library is None:
        plain = fmi2.fmi2CallbackLoggerTYPE(lambda *arguments: say(arguments[-1]))
        return plain, None, plain
    sink = _SINK(say)
    _living.append(sink)
    environment = ctypes.cast(sink, ctypes.c_void_p).value
    library.logger_takes(ctypes.c_void_p(environment))
    address = ctypes.cast(library.logger_say, ctypes.c_void_p).value
    return fmi2.fmi2CallbackLoggerTYPE(address), environment, sink
