"""Cells whose disk refuses: the child of a process that has tests/validate/fakes/refusing_disk.c in LD_PRELOAD.

REFUSED names a file of JSON, {"below": folder, "first": number, "last": number, "error": errno};
the number of requests is written beside it.
"""

import ctypes
import json
import os
from dataclasses import replace
from pathlib import Path

import campaign_fakes
import numpy as np

from models.catalog import load_scene
from models.netcdf import Column, write_columns
from validate.tasks import child

load_scene("three_cart")  # once, in the server


def _write_replay(path: Path, *_: object) -> None:
    write_columns(
        path,
        [Column(name="t", dimension="time", values=np.arange(3.0), unit="s")],
        {"content": "a fake replay"},
    )


WRITING = replace(campaign_fakes.PLUGIN, write_replay=_write_replay)


def main(folder: Path) -> int:
    place = Path(os.environ["REFUSED"])
    told = json.loads(place.read_text())
    disk = ctypes.CDLL(None)
    disk.requests.restype = ctypes.c_long
    disk.refuse(
        told["below"].encode(),
        ctypes.c_long(told["first"]),
        ctypes.c_long(told["last"]),
        told["error"],
    )
    try:
        return child.main(folder)
    finally:
        place.with_suffix(".count").write_text(str(disk.requests()))
