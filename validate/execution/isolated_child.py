"""The child process of one isolated call: `python -m validate.execution.isolated_child FOLDER`, or a fork that calls `run_and_exit`; see validate.execution.isolated.

A fork of it that comes back through our code - an FMU may fork within doStep - ends silently: only the first process answers.

What a child process does first: die with its parent, leave no core file, stay within its limits, and tell why it crashes if it was for memory.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import importlib
import json
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import Any, NoReturn

from models.errors import MachineError, TouchstoneError
from validate.execution.isolated import ANSWER, GIVEN, REFUSED, REQUEST, TAKEN, Ending, ModelFault
from validate.execution.process import PARENT_VARIABLE
from validate.store.disk import raise_if_disk_ended

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


# New objects after which Python looks for cycles among them, instead of 700: those of NumPy and FMPy stay, and looking took a fifteenth of a replay.
_OBJECTS = 200_000
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
    back and returns, so that the crash goes on as it would have. What is returned must live as long as the process lives.
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


def _call(folder: Path, request: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    module, _, name = request["function"].partition(":")
    arrays: dict[str, Any] = {}
    if (folder / GIVEN).exists():
        import numpy as np

        with np.load(folder / GIVEN, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
    function = getattr(importlib.import_module(module), name)
    sys.dont_write_bytecode = True  # foreign code may narrow the limit of files, and what Python then writes is cut off
    value = function(request["request"], arrays)
    return value if isinstance(value, tuple) else (value, {})


def _answer(folder: Path, ending: Ending, *, value: Any = None, sentence: str = "") -> None:
    aside = folder / f".{ANSWER}"
    aside.write_text(json.dumps({"ending": ending.name, "value": value, "sentence": sentence}, allow_nan=False), encoding="utf-8")
    os.replace(aside, folder / ANSWER)


def main(folder: Path, first: int) -> None:
    """Call the function and write the answer. first: the number of the process that may."""
    gc.set_threshold(_OBJECTS)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    limit_resources(file_bytes=request["file"], memory_bytes=request["memory"], cpu_seconds=2 * request["seconds"])
    _kept = mark_refused_memory(folder / REFUSED)
    try:
        value, arrays = _call(folder, request)
        _end_copies(first)
        if arrays:
            import numpy as np

            np.savez(folder / TAKEN, allow_pickle=False, **arrays)
        _answer(folder, Ending.OK, value=value)
    except Exception as error:  # noqa: BLE001 - whatever it was, it is the answer
        _end_copies(first)
        ending, sentence = _ending(folder, error)
        _answer(folder, ending, sentence=sentence)


def _ending(folder: Path, error: Exception) -> tuple[Ending, str]:
    """How a call ends that raised, and the sentence."""
    if isinstance(error, ModelFault):
        return error.ending, str(error)
    if isinstance(error, MachineError):
        return Ending.MACHINE, str(error)
    if isinstance(error, TouchstoneError):
        return Ending.ERROR, str(error)
    if isinstance(error, MemoryError):
        return Ending.MEMORY_LIMIT, ""
    traceback.print_exc()
    try:
        raise_if_disk_ended(folder, error)
    except MachineError as refusal:
        return Ending.MACHINE, str(refusal)
    return Ending.EXCEPTION, f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"


def _end_copies(first: int) -> None:
    if os.getpid() != first:
        os._exit(0)


def run_and_exit(folder: Path) -> NoReturn:
    """The whole of the child: nobody's exit handlers are run, as a library that crashes while it is unloaded must not spoil a finished call."""
    try:
        main(folder, os.getpid())
        code = 0
    except BaseException:  # noqa: BLE001 - it goes to the output; without an answer the parent knows enough
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    die_with_parent()
    adopt_orphans()
    run_and_exit(Path(sys.argv[1]))
