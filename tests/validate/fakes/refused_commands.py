"""Command lines whose disk refuses: each in a fork of this process, which has tests/validate/fakes/refusing_disk.c in LD_PRELOAD.

    {"words": [..], "below": folder, "first": number, "last": number, "error": errno, "told": file,
    "environment": {..}}
        ->  [exit code, number of requests]

A line of JSON each. What the command says is in the file `told`. Cells do not run: what an earlier
campaign stored of them is copied by their process (copied_cell.py).
"""

import ctypes
import importlib
import json
import os
import sys
import tempfile
from dataclasses import replace
from typing import Any

import campaign_fakes

from models.catalog import load_scene
from validate.campaign.engine import MODULES
from validate.cli import group
from validate.tasks import worker
from validate.tasks.plugins import DEFAULT

PLUGIN = replace(campaign_fakes.PLUGIN, write_report=DEFAULT.write_report)


def _run(request: dict[str, Any]) -> list[int]:
    disk = ctypes.CDLL(None)
    disk.requests.restype = ctypes.c_long
    os.environ.update(request.get("environment", {}))
    tempfile.tempdir = None  # found anew
    tempfile.gettempdir()
    told = os.open(request["told"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(told, 1)
    os.dup2(told, 2)
    disk.refuse(
        request["below"].encode(),
        ctypes.c_long(request["first"]),
        ctypes.c_long(request["last"]),
        request["error"],
    )
    code = group.run(request["words"])
    sys.stdout.flush()
    return [code, disk.requests()]


def _serve() -> None:
    for name in (
        *MODULES,
        "reports.render",
        "validate.campaign.campaign",
        "validate.tasks.paper",
        "validate.cli.all",
        "validate.cli.fmu",
    ):
        importlib.import_module(name)
    load_scene("three_cart")  # once
    worker._FUNCTION = "copied_cell:main"
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
