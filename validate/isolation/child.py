"""The child process of one isolated call: `python -m validate.isolation.child FOLDER`; see validate.isolation.run.

A fork of it that comes back through our code - an FMU may fork within doStep - ends silently: only the first process answers.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from models.errors import MachineError, TouchstoneError
from validate.disk import raise_if_disk_ended
from validate.isolation.ending import Ending, ModelFault
from validate.isolation.guards import adopt_orphans, die_with_parent, limit_resources, mark_refused_memory
from validate.isolation.run import ANSWER, GIVEN, REFUSED, REQUEST, TAKEN


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
    except ModelFault as fault:
        _end_copies(first)
        _answer(folder, fault.ending, sentence=str(fault))
    except MachineError as error:
        _end_copies(first)
        _answer(folder, Ending.MACHINE, sentence=str(error))
    except TouchstoneError as error:
        _end_copies(first)
        _answer(folder, Ending.ERROR, sentence=str(error))
    except MemoryError:
        _end_copies(first)
        _answer(folder, Ending.MEMORY_LIMIT)
    except Exception as error:  # noqa: BLE001 - whatever it was, it is the answer
        _end_copies(first)
        import traceback

        traceback.print_exc()
        try:
            raise_if_disk_ended(folder, error)
        except MachineError as refusal:
            _answer(folder, Ending.MACHINE, sentence=str(refusal))
        else:
            _answer(folder, Ending.EXCEPTION, sentence=f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}")


def _end_copies(first: int) -> None:
    if os.getpid() != first:
        os._exit(0)


if __name__ == "__main__":
    own = os.getpid()
    die_with_parent()
    adopt_orphans()
    try:
        main(Path(sys.argv[1]), own)
        code = 0
    except BaseException:  # noqa: BLE001 - it goes to the output; without an answer the parent knows enough
        import traceback

        traceback.print_exc()
        code = 1
    # Nobody's exit handlers are run: a library that crashes while it is unloaded cannot spoil a finished call.
    os._exit(code)
