"""Hostile files for every reader, by random mutation of good ones, and what each reader does with them.

    # "read", "refused", or the traceback; "hang" after HANG seconds of CPU
    outcome = tried(READERS["plan CSV"], random, folder)

A reader may read a file or refuse it by one of our own errors; anything else is a fault. In the
tests `random` is hypothesis's `randoms()`, which shrinks a fault to the fewest and plainest
mutations. A reader that hangs is stopped by CPU time here, since hypothesis looks at its
clock only when a test has ended.
"""

import random
import signal
import traceback
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hostile_mutations import spoilt_bytes, spoilt_data, spoilt_text
from hostile_records import (
    read_answer,
    read_record,
    read_scheduler,
    read_table,
    recover,
    resume,
    spoilt_answer,
    spoilt_campaign,
    spoilt_folder,
    spoilt_leg,
    spoilt_scheduler,
    spoilt_stored_leg,
    spoilt_table,
    take_leg,
)  # fmt: skip

from models.errors import TouchstoneError
from reports.load import ReportError

HANG = 20.0  # [s of CPU]; every good file is read in less than a tenth
_ASLEEP = 600.0  # [s]; whoever waits for something needs no CPU
ROOT = Path(__file__).parents[3]


class Hang(BaseException):
    """Raised by the alarm."""


@dataclass(frozen=True)
class Reader:
    """make: writes a hostile file by a generator of random numbers and hands back what `read` takes."""

    make: Callable[[random.Random, Path], Path]
    read: Callable[[Path], Any]


def tried(reader: Reader, rng: random.Random, folder: Path) -> str:
    """What came of one hostile file."""

    def ring(*_: object) -> None:
        raise Hang

    path = reader.make(rng, folder)
    before = {number: signal.signal(number, ring) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, HANG)
    signal.setitimer(signal.ITIMER_REAL, _ASLEEP)
    try:
        reader.read(path)
    except (TouchstoneError, ReportError) as error:
        return "refused" if str(error).strip() else "refused without a word"
    except Hang:
        return "hang"
    except BaseException:  # noqa: BLE001 - whatever it is, it is what is looked for
        return traceback.format_exc()
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
    return "read"


def _toml(data: dict[str, Any]) -> str:
    from validate.processes.toml_text import toml_text, toml_value

    plain = {key: "" if value is None else value for key, value in data.items()}
    return "\n".join(f"{toml_text(str(key))} = {toml_value(value)}" for key, value in plain.items())


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_none(item) for item in value]
    return "" if value is None else value


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def _toml_file(rng: random.Random, folder: Path, text: str) -> Path:
    import tomllib

    if rng.random() < 0.5:
        data = spoilt_text(rng, text)
    else:
        data = _toml(_without_none(spoilt_data(rng, tomllib.loads(text)))).encode(
            "utf-8", "replace"
        )
    return _written(folder / "hostile.toml", data)


# ---- each reader
#   ----------------------------------------------------------------------------------------------------------------------------


@cache
def _scene() -> Any:
    from models.catalog import load_scene

    return load_scene("three_cart").with_task(steps=6)


def _trajectory() -> Any:
    from models.trajectory import Trajectory, uniform_grid

    scene = _scene()
    state = np.tile(np.array(scene.task.start), (7, 1))
    return Trajectory(
        t=uniform_grid(0.01, 6),
        q=state[:, :3],
        v=state[:, 3:],
        u=np.ones((6, 2)),
        lam=np.zeros((6, 2)),
    )


def _plan(rng: random.Random, folder: Path) -> Path:
    from models.trajectory import write_csv

    good = folder / "good.csv"
    if not good.exists():
        write_csv(good, _trajectory(), _scene())
    return _written(folder / "hostile.csv", spoilt_text(rng, good.read_text(encoding="utf-8")))


def _read_plan(path: Path) -> None:
    from models.trajectory import read_csv

    read_csv(path, _scene())


def _map(rng: random.Random, folder: Path) -> Path:
    from foreign_fmu import FULL_MAP

    if not (folder / "cart.fmu").exists():
        _zip(folder / "cart.fmu", _good_entries())
        (folder / "plan.csv").write_text(
            "t,x,v_x,F\n0,0,0,1\n0.1,0,0,1\n0.2,0,0,\n", encoding="utf-8"
        )
    return _toml_file(rng, folder, FULL_MAP)


def _read_map(path: Path) -> None:
    from models.plan_table import PlanTable
    from validate.fmi.description import read_package
    from validate.judge.replay.map_schema import read_map
    from validate.judge.replay.mapping import wire

    given = read_map(path)
    wire(
        read_package(path.with_name("cart.fmu")),
        PlanTable(path.with_name("plan.csv")),
        given,
        None,
        "map",
    )


def _campaign(rng: random.Random, folder: Path) -> Path:
    examples = sorted((ROOT / "docs" / "campaigns").glob("*.toml"))
    return _toml_file(rng, folder, rng.choice(examples).read_text(encoding="utf-8"))


def _read_campaign(path: Path) -> None:
    from validate.campaign.read import read_campaign

    read_campaign(path)


def _scene_file(rng: random.Random, folder: Path) -> Path:
    text = (ROOT / "tests" / "scenes" / "oscillator.py").read_text(encoding="utf-8")
    return _written(folder / "oscillator.py", spoilt_text(rng, text))


def _read_scene(path: Path) -> None:
    from models.catalog import load_scene
    from models.scene.text import scene_text

    scene_text(load_scene(str(path)))


def _good_entries() -> dict[str, bytes]:
    from foreign_fmu import COSIMULATION, DESCRIPTION, EXCHANGE

    text = DESCRIPTION.format(kinds=EXCHANGE + COSIMULATION).replace("{{", "{").replace("}}", "}")
    return {
        "modelDescription.xml": text.encode(),
        "binaries/linux64/cart.so": b"\x7fELF" + bytes(2000),
    }


def _zip(path: Path, entries: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            item = zipfile.ZipInfo("entry")
            item.filename = item.orig_filename = name
            item.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(item, data)
    return path


def _fmu(rng: random.Random, folder: Path) -> Path:
    entries = _good_entries()
    kind = rng.randrange(3)
    if kind == 0:
        entries["modelDescription.xml"] = spoilt_text(rng, entries["modelDescription.xml"].decode())
    elif kind == 1:
        name = rng.choice(
            [
                "../x",
                "/x",
                "a\\b",
                "x" * 300,
                "a/../b",
                "resources/x.xml",
                ".",
                "",
                "modelDescription.xml/x",
                "\ud7ff\x01",
                "CON",
                "a/b",
            ]
        )
        entries[name] = rng.choice([b"", b"<a>", b"\0" * 100_000, b"<!DOCTYPE x>"])
    path = _zip(folder / "hostile.fmu", entries)
    return _written(path, spoilt_bytes(rng, path.read_bytes())) if kind == 2 else path


def _read_fmu(path: Path) -> None:
    import shutil

    from validate.fmi.archive import problems, unpack
    from validate.fmi.description import read_package

    problems(path)
    package = read_package(path)
    out = path.with_suffix(".out")
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    unpack(package, out)


def _netcdf(rng: random.Random, folder: Path) -> Path:
    from models.netcdf import Column, write_columns
    from models.trajectory_netcdf import write_netcdf

    if rng.random() < 0.5:
        good = folder / "good.nc"
        if not good.exists():
            write_netcdf(good, _trajectory(), _scene())
        return _written(folder / "hostile.nc", spoilt_bytes(rng, good.read_bytes()))
    names = rng.sample(
        [
            "t",
            "q1",
            "q2",
            "q3",
            "v1",
            "v2",
            "v3",
            "u1",
            "u3",
            "lam_left",
            "lam_right",
            "typo",
            "gain_u1_q1",
        ],
        rng.randint(1, 12),
    )
    sizes = [rng.choice([0, 1, 6, 7]) for _ in range(2)]
    columns = []
    for name in names:
        which = rng.randrange(2)
        values = rng.choice(
            [
                np.zeros(sizes[which]),
                np.full(sizes[which], np.nan),
                np.arange(sizes[which]),
                np.full(sizes[which], 1e308),
            ]
        )
        columns.append(
            Column(
                name=name,
                dimension=("node", "step")[which],
                values=values,
                unit=rng.choice(["m", "s", "m/s", "N", "", "kg"]),
            )
        )
    path = folder / "hostile.nc"
    write_columns(
        path,
        columns,
        {"scene": rng.choice(["three_cart", "", "x"]), "hold": rng.choice(["zero", "nothing"])},
    )
    return path


def _read_netcdf(path: Path) -> None:
    from models.trajectory_netcdf import read_netcdf

    read_netcdf(path, _scene())


READERS: dict[str, Reader] = {
    "plan CSV": Reader(_plan, _read_plan), "map TOML": Reader(_map, _read_map),
    "campaign TOML": Reader(_campaign, _read_campaign),
    "scene file": Reader(_scene_file, _read_scene), "FMU": Reader(_fmu, _read_fmu),
    "NetCDF": Reader(_netcdf, _read_netcdf),
    "record JSON": Reader(spoilt_campaign, read_record),
    "campaign folder": Reader(spoilt_folder, resume),
    "stored leg": Reader(spoilt_stored_leg, take_leg),
    "scheduler file": Reader(spoilt_scheduler, read_scheduler),
    "foreign plan CSV": Reader(spoilt_table, read_table),
    "leg of a lost run": Reader(spoilt_leg, recover),
    "isolated answer": Reader(spoilt_answer, read_answer),
}  # fmt: skip
