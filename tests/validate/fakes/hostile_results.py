"""Spoilt results - of a planner, a compiler, a cell, an isolated call - and what reads them."""

import json
import random
import struct
from pathlib import Path

import numpy as np
from hostile_mutations import spoilt_bytes, spoilt_json, spoilt_text
from hostile_records import KEY, good_record

from models.errors import TouchstoneError

# ---- somebody's plan --------------------------------------------------------------------------------------------------------------------------


def spoilt_table(rng: random.Random, folder: Path) -> Path:
    mark = rng.choice([",", ";", "\t"])
    rows = [["t", "x", "v_x", "F"], *([f"{0.1 * row:.1f}", "0", "1e-3", "" if row == 5 else "1"] for row in range(6))]
    path = folder / "foreign.csv"
    path.write_bytes(spoilt_text(rng, "# a plan\n" + "\n".join(mark.join(row) for row in rows)))
    return path


def read_table(path: Path) -> None:
    from models.plan_table import PlanTable

    table = PlanTable(path)
    table.check_form()
    for name in {"t", "x", "v_x", "F"} & set(table.names):
        table.column(name, last_is_open=name == "F")


# ---- a library --------------------------------------------------------------------------------------------------------------------------------


def library() -> bytes:
    """A library for 64 bits, of nothing but its tables: it exports one function and needs the C library."""
    texts = b"\0fmi3DoStep\0libc.so.6\0GLIBC_2.34\0"
    symbols = struct.pack("<IBBHQQ", 0, 0, 0, 0, 0, 0) + struct.pack("<IBBHQQ", 1, 0x12, 0, 7, 64, 8)
    dynamic = struct.pack("<QQ", 1, 12) + struct.pack("<QQ", 0, 0)
    content, at, places = b"", 64, []
    for part in (texts, symbols, dynamic):
        places.append((at + len(content), len(part)))
        content += part
    table = [(0, 0, 0, 0, 0), (3, *places[0], 0, 0), (11, *places[1], 1, 24), (6, *places[2], 1, 16)]
    sections = b"".join(
        struct.pack("<IIQQQQIIQQ", 0, kind, 0, 0, offset, size, link, 0, 0, entry) for kind, offset, size, link, entry in table
    )
    identity = b"\x7fELF\x02\x01\x01" + bytes(9)
    header = identity + struct.pack("<HHIQQQIHHHHHH", 3, 62, 1, 0, 0, at + len(content), 0, 64, 0, 0, 64, len(table), 1)
    return header + content + sections


def spoilt_library(rng: random.Random, folder: Path) -> Path:
    path = folder / "hostile.so"
    data = bytearray(library())
    for _ in range(rng.randint(1, 3)):  # a number of a table, which random bytes seldom make small, or large
        at, size = rng.randrange(len(data) - 8), rng.choice([2, 4, 8])
        data[at : at + size] = rng.choice([0, 1, 2, 2**15, 2**31, 2**63 - 1, 2**64 - 1]).to_bytes(8, "little")[:size]
    path.write_bytes(spoilt_bytes(rng, bytes(data)) if rng.random() < 0.3 else bytes(data))
    return path


def read_spoilt_library(path: Path) -> None:
    from validate.fmu_check.files import NotElf, read_library

    try:
        read_library(path.read_bytes())
    except NotElf as error:
        raise TouchstoneError(str(error)) from error


# ---- what a child left ------------------------------------------------------------------------------------------------------------------------


def spoilt_leg(rng: random.Random, folder: Path) -> Path:
    """What a run that was lost left of its first leg."""
    content = {
        "key": KEY, "pipeline": "p", "limit": None, "profile": {"solve": 1.0}, "files": {},
        "stages": [{**good_record()["stages"][0], "has_plan": False}],
    }  # fmt: skip
    (folder / "leg_1").mkdir(exist_ok=True)
    (folder / "leg_1" / "leg.json").write_bytes(spoilt_json(rng, content))
    return folder


def recover(path: Path) -> None:
    from validate.tasks.leg import PlannedLeg, legs_in

    if not legs_in(path, [PlannedLeg(0, 1, KEY, KEY)]):
        raise TouchstoneError("there is none")


def spoilt_answer(rng: random.Random, folder: Path) -> Path:
    """What an isolated call left: foreign code runs in the same process, and may write there, too."""
    from validate.execution.isolated import ANSWER, TAKEN

    np.savez(folder / TAKEN, allow_pickle=False, t=np.arange(3.0), q=np.zeros((3, 2)))
    if rng.random() < 0.5:
        (folder / TAKEN).write_bytes(spoilt_bytes(rng, (folder / TAKEN).read_bytes()))
    told = {"ending": rng.choice(["OK", "ERROR", "MACHINE", "EXCEPTION"]), "value": {"a": 1}, "sentence": "a sentence"}
    (folder / ANSWER).write_bytes(json.dumps(told).encode() if rng.random() < 0.3 else spoilt_json(rng, told))
    return folder


def read_answer(path: Path) -> None:
    from validate.execution.isolated import left_by

    answer, arrays = left_by(path)
    if not answer or not {"value", "sentence"} <= answer.keys() or any(not isinstance(array, np.ndarray) for array in arrays.values()):
        raise TouchstoneError("it left no result")
