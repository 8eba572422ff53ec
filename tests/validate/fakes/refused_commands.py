"""Command lines whose disk refuses: each in a fork of this process, which has tests/validate/fakes/refusing_disk.c in LD_PRELOAD.

    {"words": [..], "below": folder, "first": number, "last": number, "error": errno, "told": file, "environment": {..}}
        ->  [exit code, number of requests]

A line of JSON each. What the command says is in the file `told`. Cells do not run: what an earlier campaign stored of them, in the folder that CELLS
names, is copied by their process.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import campaign_fakes

from models.catalog import load_scene
from validate.cli import group
from validate.execution import worker
from validate.execution.fork_server import MODULES
from validate.execution.process import ChildProcess, child_environment
from validate.tasks.plugins import DEFAULT

PLUGIN = replace(campaign_fakes.PLUGIN, write_report=DEFAULT.write_report)


class _Copied(ChildProcess):
    """A cell's process that comes to its end at once."""

    def __init__(self, module: str, arguments: Sequence[str], *, token: str, temporary: Path, output: IO[bytes]) -> None:
        (folder,) = arguments
        stored = Path(os.environ["CELLS"]) / json.loads((Path(folder) / "task.json").read_text())["task"]["key"]
        if not stored.is_dir():
            super().__init__(module, arguments, token=token, temporary=temporary, output=output)
            return
        self.token, self._family = token, {}
        command = ["cp", *map(str, stored.iterdir()), folder]
        self._process = subprocess.Popen(command, env=child_environment(token, temporary), start_new_session=True)
        self.pid = self._process.pid


def _run(request: dict[str, Any]) -> list[int]:
    disk = ctypes.CDLL(None)
    disk.requests.restype = ctypes.c_long
    os.environ.update(request.get("environment", {}))
    tempfile.tempdir = None  # found anew
    tempfile.gettempdir()
    told = os.open(request["told"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(told, 1)
    os.dup2(told, 2)
    disk.refuse(request["below"].encode(), ctypes.c_long(request["first"]), ctypes.c_long(request["last"]), request["error"])
    code = group.run(request["words"])
    sys.stdout.flush()
    return [code, disk.requests()]


def _serve() -> None:
    for name in (
        *MODULES,
        "reports.render",
        "validate.execution.campaign",
        "validate.tasks.paper",
        "validate.cli.all",
        "validate.cli.fmu",
    ):
        importlib.import_module(name)
    load_scene("three_cart")  # once
    worker.ChildProcess = _Copied
    for line in sys.stdin:
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.write(writer, json.dumps(_run(json.loads(line))).encode())
            os._exit(0)
        os.close(writer)
        with open(reader, encoding="ascii") as answer:
            print(answer.read() or "[]", flush=True)
        os.waitpid(child, 0)


if __name__ == "__main__":
    _serve()
