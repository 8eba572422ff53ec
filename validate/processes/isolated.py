"""Call a function in a child process with limits; its ending becomes a sentence.

Endings are a closed list. The child leaves no core file, obeys its limits and marks crashes by
refused memory. A fork that returns through our code, as an FMU's may, ends silently.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import importlib
import json
import os
import pickle
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.errors import MachineError, TouchstoneError
from validate.processes.disk import (
    no_temporary_folder,
    raise_if_disk_ended,
    read_json,
    tail,
    temporary_folder,
)
from validate.processes.process import TEMPORARY, Child, Ended, Fork, can_fork, exit_in_words

if TYPE_CHECKING:
    import numpy as np


class Ending(Enum):
    """Ending of a call, as the beginning of its sentence."""

    OK = "it came to its end"
    ERROR = "it refused"  # a TouchstoneError of the function: a sentence for the user
    MACHINE = "this machine cannot"  # a MachineError of the function
    EXCEPTION = "it ended with an exception of Python"
    FATAL = "the FMU reported a fatal status"
    NOT_A_NUMBER = "the FMU gave a value that is not a finite number"
    TIME_LIMIT = "it was ended at its time limit"
    MEMORY_LIMIT = "it was ended at its memory limit"
    SIGNAL = "it crashed"
    ABORT = "it aborted"
    NO_RESULT = "its process ended without a result"


class ModelFault(Exception):  # noqa: N818 - a finding about the model, no error of ours
    """A finding about the model (FATAL, NOT_A_NUMBER) that ends an isolated function."""

    def __init__(self, ending: Ending, sentence: str) -> None:
        super().__init__(sentence)
        self.ending = ending


REQUEST = "request.json"
ANSWER = "answer.json"
OUTPUT = "output.txt"
GIVEN = "given.npz"
TAKEN = "answer.npz"
REFUSED = "memory-refused"
FOLDER_PREFIX = ".partial-isolated-"
_ASKED = "ask"
_ANSWERED = "answers"
# Interval between looks whether the child lives [s].
_LOOK = 0.05
# Calls per child. PythonFMU leaks 2.6 kB a run; 8 MB a run would reach the limit of 4 GiB.
_MOST_CALLS = 500
# File that tests for free space.
_ROOM = "room"
# Its size [bytes].
_ROOM_BYTES = 2**16
# Share of the memory limit from which a crash counts as caused by it.
_NEAR = 0.8
# Last message of C++ on an uncaught refused allocation.
_BAD_ALLOC = "std::bad_alloc"
# Length of the output's end to search for that message [bytes].
_LAST_WORDS = 4000


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a call.

    - seconds: wall time [s]; CPU time may be twice that.
    - memory: address space [bytes], with Python's 0.3 GB.
    - file: any written file [bytes].
    - output: recorded end of the output [bytes].
    """

    seconds: float = 300.0
    memory: int = 4 * 1024**3
    file: int = 512 * 1024**2
    output: int = 20_000


@dataclass(frozen=True, kw_only=True)
class Isolated:
    """Result of a call; value and arrays only if ok, else sentence.

    output: end of the output; strays: remaining processes, ended by us; cpu, wall [s]; memory:
    largest [bytes].
    """

    ending: Ending
    sentence: str
    value: Any = None
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    output: str = ""
    strays: int = 0
    cpu: float = 0.0
    wall: float = 0.0
    memory: int = 0

    @property
    def ok(self) -> bool:
        """Return whether the function finished."""
        return self.ending is Ending.OK


def run_isolated(
    function: str,
    request: Any,
    arrays: Mapping[str, np.ndarray] | None = None,
    *,
    limits: Limits | None = None,
    what: str = "the run",
    ours: bool = False,
) -> Isolated:
    """Call a function in a child process as name(request, arrays) -> value or (value, arrays).

    Parameters
    ----------
    function
        `module:name`.
    request
        JSON data, like the value; NaN is refused.
    arrays
        Arrays of numbers by name (any shape) [any unit].
    limits
        Limits of the call.
    what
        Subject of the sentence about its ending.
    ours
        Only our code runs, so that a fork of this process may be used.

    Returns
    -------
    Isolated
        With the `ending` of the child.

    Raises
    ------
    MachineError
        If the temporary folder cannot be written.
    """
    limits = limits or Limits()
    with temporary_folder(FOLDER_PREFIX) as place:
        folder = place.resolve()
        _write_request(folder, function, request, arrays, limits)
        began = time.monotonic()
        begin = Fork if ours and can_fork() else Child
        with closing(
            begin("validate.processes.isolated:main", folder, output=folder / OUTPUT)
        ) as child:
            over_time = not child.wait(limits.seconds)
            ended = child.end()
            return _told(folder, ended, over_time, time.monotonic() - began, limits, what)


def packed(*things: Any) -> dict[str, np.ndarray]:
    """Return any of our objects as an array (n,) [-] of a call. Raises PicklingError.

    Only towards a child: answers lie beside foreign code, and must not be unpickled.
    """
    import numpy as np

    return {"packed": np.frombuffer(pickle.dumps(things), dtype=np.uint8)}


def unpacked_from(arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the tuple of objects packed into arrays (n,) [-]. Raises UnpicklingError."""
    return pickle.loads(arrays["packed"].tobytes())


class IsolatedCalls:
    """`run_isolated` for many calls in one child; must be closed.

    A call that ends a used child is repeated in a new one, so that no call suffers from earlier
    ones. limits.seconds is per call.
    """

    def __init__(self, limits: Limits, what: str) -> None:
        self._limits, self._what, self._made = limits, what, 0
        self._child: Child | None = None

    def __call__(
        self, function: str, request: Any, arrays: Mapping[str, np.ndarray] | None = None
    ) -> Isolated:
        """Call a function as `run_isolated`. Raises MachineError."""
        done = self._call(function, request, arrays)
        if self._child is None and self._made > 1 and done.ending is not Ending.TIME_LIMIT:
            done = self._call(function, request, arrays)
        if self._made >= _MOST_CALLS:
            self.close()
        return done

    def _call(
        self, function: str, request: Any, arrays: Mapping[str, np.ndarray] | None
    ) -> Isolated:
        if self._child is None:
            self._begin()
        folder, child, began = self._folder, self._child, time.monotonic()
        assert child is not None
        for name in (ANSWER, TAKEN, GIVEN):
            (folder / name).unlink(missing_ok=True)
        _write_request(folder, function, request, arrays, self._limits)
        self._made += 1
        os.write(self._ask, b"?")
        answered, over_time = False, False
        while not (answered or over_time or child.wait(0.0)):
            answered = bool(select.select([self._answers], [], [], _LOOK)[0])
            over_time = not answered and time.monotonic() - began > self._limits.seconds
        if answered:
            os.read(self._answers, 1)
        ended = Ended(code=0) if answered else child.end()
        done = _told(folder, ended, over_time, time.monotonic() - began, self._limits, self._what)
        if not done.ok:
            self.close()
        return done

    def _begin(self) -> None:
        try:
            self._folder = Path(tempfile.mkdtemp(prefix=FOLDER_PREFIX)).resolve()
            (self._folder / TEMPORARY).mkdir()
            self._ask, self._answers = (self._pipe(name) for name in (_ASKED, _ANSWERED))
        except OSError as error:
            raise no_temporary_folder(error) from error
        _write_request(self._folder, "", None, None, self._limits)
        self._child, self._made = (
            Child(
                "validate.processes.isolated:main_again", self._folder, output=self._folder / OUTPUT
            ),
            0,
        )

    def _pipe(self, name: str) -> int:
        """Open for reading and writing, so that no side waits for the other to open it."""
        os.mkfifo(self._folder / name)
        return os.open(self._folder / name, os.O_RDWR)

    def close(self) -> None:
        """End the child, if there is one."""
        if self._child is not None:
            child, self._child = self._child, None
            child.close()
            for pipe in (self._ask, self._answers):
                os.close(pipe)


def _write_request(
    folder: Path,
    function: str,
    request: Any,
    arrays: Mapping[str, np.ndarray] | None,
    limits: Limits,
) -> None:
    text = json.dumps(
        {
            "function": function,
            "request": request,
            "memory": limits.memory,
            "seconds": limits.seconds,
            "file": limits.file,
        },
        allow_nan=False,
    )
    try:
        (folder / TEMPORARY).mkdir(exist_ok=True)
        (folder / OUTPUT).touch()
        (folder / REQUEST).write_text(text, encoding="utf-8")
        if arrays:
            import numpy as np

            np.savez(folder / GIVEN, allow_pickle=False, **arrays)
    except OSError as error:
        raise MachineError(
            f"cannot write {folder} ({error.strerror}); make room or set TMPDIR."
        ) from error


def _see_room(folder: Path) -> None:
    """Raise MachineError if the folder is full, as the child's answer may then be lost."""
    try:
        with open(folder / _ROOM, "wb") as file:
            file.write(bytes(_ROOM_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise_if_disk_ended(folder, error)


def _told(
    folder: Path, ended: Ended, over_time: bool, wall: float, limits: Limits, what: str
) -> Isolated:
    peak = max(ended.space, ended.memory)
    answer, arrays = left_by(folder)
    if not answer:
        _see_room(folder)
    refused = (folder / REFUSED).exists() or (
        ended.code == -signal.SIGABRT and _BAD_ALLOC in tail(folder / OUTPUT, _LAST_WORDS)
    )
    ending, sentence = _classify(answer, ended, over_time, peak, limits, what, refused)
    return Isolated(
        ending=ending,
        sentence=sentence,
        value=answer.get("value") if ending is Ending.OK else None,
        arrays=arrays,
        output=tail(folder / OUTPUT, limits.output),
        strays=ended.strays,
        cpu=ended.cpu,
        wall=wall,
        memory=peak,
    )


def left_by(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the child's answer and arrays (any shape) [any unit], empty if incomplete.

    Raises nothing: foreign code may have written there.
    """
    answer = _answer(folder)
    if answer.get("ending") != Ending.OK.name:
        return answer, {}
    try:
        return answer, _arrays_in(folder / TAKEN)
    except Exception:  # noqa: BLE001 - numpy, zipfile and zlib raise many types
        return {}, {}


def _answer(folder: Path) -> dict[str, Any]:
    answer = read_json(folder / ANSWER)
    if (
        not isinstance(answer, dict)
        or not isinstance(answer.get("ending"), str)
        or answer["ending"] not in Ending.__members__
    ):
        return {}
    return {"value": None, "sentence": "", **answer}


def _classify(
    answer: dict[str, Any],
    ended: Ended,
    over_time: bool,
    peak: int,
    limits: Limits,
    what: str,
    refused: bool,
) -> tuple[Ending, str]:
    ending = Ending[answer["ending"]] if answer else None
    if ending is Ending.OK:
        return ending, ""
    if ending in (Ending.ERROR, Ending.MACHINE):
        return ending, str(answer["sentence"])
    if ending is Ending.MEMORY_LIMIT or (
        not over_time and (refused or peak >= _NEAR * limits.memory)
    ):
        return (
            Ending.MEMORY_LIMIT,
            f"{what}: {Ending.MEMORY_LIMIT.value} of {limits.memory / 1024**3:.3g} GiB.",
        )
    if ending is not None:
        return ending, f"{what}: {ending.value}: {str(answer['sentence']).rstrip('.')}."
    if over_time or ended.code == -signal.SIGXCPU:
        return Ending.TIME_LIMIT, f"{what}: {Ending.TIME_LIMIT.value} of {limits.seconds:g} s."
    if ended.code == -signal.SIGABRT:
        return Ending.ABORT, f"{what}: {Ending.ABORT.value} (SIGABRT)."
    if ended.code < 0:
        return Ending.SIGNAL, f"{what}: {Ending.SIGNAL.value} with {exit_in_words(ended.code)}."
    return Ending.NO_RESULT, f"{what}: {Ending.NO_RESULT.value} ({exit_in_words(ended.code)})."


def _arrays_in(path: Path) -> dict[str, np.ndarray]:
    if not path.exists():
        return {}
    import numpy as np

    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


# Allocations between garbage collections, instead of 700, which took a fifteenth of a replay.
_OBJECTS = 200_000
# Larger than any module's bytecode [bytes].
_ANY_BYTECODE = 16 * 1024**2


def limit_resources(
    *, file_bytes: int, memory_bytes: int | None = None, cpu_seconds: float | None = None
) -> None:
    """Forbid core files and larger files, and limit address space and CPU time if given.

    Narrower limits stay. Under a narrow file limit no bytecode is written, because truncated
    bytecode would break later processes.
    """
    if file_bytes < _ANY_BYTECODE:
        sys.dont_write_bytecode = True
    import resource  # missing on Windows, where no child can be started

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    new_limits = {
        resource.RLIMIT_FSIZE: file_bytes,
        resource.RLIMIT_AS: memory_bytes,
        resource.RLIMIT_CPU: None if cpu_seconds is None else int(cpu_seconds) + 1,
    }
    for kind, limit in new_limits.items():
        soft, hard = resource.getrlimit(kind)
        if limit is not None and (soft == resource.RLIM_INFINITY or soft > limit):
            resource.setrlimit(kind, (limit, hard))


def mark_refused_memory(mark: Path) -> Any:
    """Let a crash after a refused allocation write the file `mark`.

    C code that ignores malloc's failure writes to address 0, with errno still ENOMEM. The Python
    handler works for code called through ctypes, such as FMUs; it restores the former handler, so
    that the crash continues. The returned object must live as long as the process.
    """
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
    arrays = _arrays_in(folder / GIVEN)
    function = getattr(importlib.import_module(module), name)
    sys.dont_write_bytecode = (
        True  # foreign code may narrow the file limit, which truncates bytecode
    )
    value = function(request["request"], arrays)
    return value if isinstance(value, tuple) else (value, {})


def _write_answer(folder: Path, ending: Ending, *, value: Any = None, sentence: str = "") -> None:
    aside = folder / f".{ANSWER}"
    aside.write_text(
        json.dumps({"ending": ending.name, "value": value, "sentence": sentence}, allow_nan=False),
        encoding="utf-8",
    )
    os.replace(aside, folder / ANSWER)


def main(folder: Path) -> None:
    """Call the function and write the answer."""
    request, _kept = _limited(folder, again=False)
    _answered(folder, request, os.getpid())


def main_again(folder: Path) -> None:
    """Answer the calls of `IsolatedCalls`, until this process is ended."""
    _, _kept = _limited(folder, again=True)
    first = os.getpid()
    with (
        open(folder / _ASKED, "rb", buffering=0) as asked,
        open(folder / _ANSWERED, "wb", buffering=0) as answers,
    ):
        while asked.read(1):
            _answered(folder, json.loads((folder / REQUEST).read_text(encoding="utf-8")), first)
            answers.write(b".")


def _limited(folder: Path, again: bool) -> tuple[dict[str, Any], Any]:
    """Limit this process; return the request, and an object to keep alive."""
    gc.set_threshold(_OBJECTS)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    seconds = None if again else 2 * request["seconds"]
    limit_resources(file_bytes=request["file"], memory_bytes=request["memory"], cpu_seconds=seconds)
    return request, mark_refused_memory(folder / REFUSED)


def _answered(folder: Path, request: dict[str, Any], first: int) -> None:
    try:
        value, arrays = _call(folder, request)
        _end_copies(first)
        if arrays:
            import numpy as np

            np.savez(folder / TAKEN, allow_pickle=False, **arrays)
        _write_answer(folder, Ending.OK, value=value)
    except Exception as error:  # noqa: BLE001 - any error is an answer
        _end_copies(first)
        ending, sentence = _ending(folder, error)
        _write_answer(folder, ending, sentence=sentence)


def _ending(folder: Path, error: Exception) -> tuple[Ending, str]:
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
