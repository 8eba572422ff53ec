"""Where finished tasks lie: one folder a task, written aside, made durable, then renamed.

No lock, nothing half-written.

    DIR/runs/<key>/record.json, trajectory.nc, replay.nc, log.txt, task.json, files.json   DIR/runs/.partial-*
        being written
    DIR/legs/<key>/                        what they are made of (validate.tasks.leg)
    DIR/surveys/<key>.json                 how their plans fare in perturbed worlds
                                           (validate.tasks.path)

Whatever kills a campaign, a folder under its key is whole. Two campaigns may write into the same
DIR.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from models.errors import TouchstoneError
from reports.records.check_record import CheckRecord, record_of
from reports.records.record import RunRecord
from validate.processes.disk import (
    PARTIAL,
    aside_name,
    disk_error,
    fsync,
    fsync_whole,
    read_json,
    refusals_in_words,
    renamed,
    tail,
)

RECORD = "record.json"
LOG = "log.txt"
REQUEST = "task.json"
PROGRESS = "progress.txt"
MACHINE = "machine.txt"
# Names and sizes [bytes] of a run's NetCDF files, so that it is seen where one is gone or cut off.
FILES = "files.json"
# How much of a log is read, from its end [bytes].
_LOG_BYTES = 1_000_000
_OLD = "-old"
# Letters and digits of what tells one unfinished folder of a task from another.
_TOKEN = 32


class StoreError(TouchstoneError):
    """A folder that cannot be a campaign's folder."""


def progress(folder: Path, text: str) -> None:
    """Say where a task is, for the parent to read if it never comes back."""
    (folder / PROGRESS).write_text(text, encoding="utf-8")


def progress_in(folder: Path) -> str:
    """Where the task is whose unfinished folder this is, in words."""
    try:
        return (folder / PROGRESS).read_text(encoding="utf-8")
    except OSError:
        return "its start"


def log_in(folder: Path) -> str:
    """The end of a task's log; empty where there is none."""
    return tail(folder / LOG, _LOG_BYTES)


class Store:
    """The runs of one campaign folder; see the module docstring."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs, self.legs, self.surveys = folder / "runs", folder / "legs", folder / "surveys"

    def prepare(self) -> None:
        """Create the folder, see that it can be written, and remove what dead campaigns left.

        Raises StoreError, MachineError.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(
                f"--out {self.folder}: there is a file of that name; a campaign needs a folder."
            )
        with refusals_in_words(self.folder):
            self.runs.mkdir(parents=True, exist_ok=True)
            probe = self.runs / f"{PARTIAL}probe-{uuid.uuid4().hex}"
            probe.mkdir()
            with contextlib.suppress(FileNotFoundError):  # another campaign tidied it away
                probe.rmdir()
        for left in self.runs.glob(f"{PARTIAL}*"):
            if not _owner_lives(left.name):
                if left.name.endswith(_OLD):
                    self._put_back(left)
                shutil.rmtree(left, ignore_errors=True)
        for aside in (*self.folder.glob(f"{PARTIAL}*"), *self.surveys.glob(f"{PARTIAL}*")):
            if not _owner_lives(aside.name):
                with contextlib.suppress(OSError):
                    aside.unlink()

    def _put_back(self, old: Path) -> None:
        """A run that was to be replaced when its campaign was killed, and was not."""
        with contextlib.suppress(
            OSError, ValueError, KeyError, TypeError, RecursionError
        ):  # damaged, or the newer run is there
            key = json.loads((old / RECORD).read_bytes())["key"]
            if key == Path(key).name and not key.startswith("."):
                os.rename(old, self.runs / key)

    def read(self, key: str) -> RunRecord | CheckRecord | None:
        """The stored record of a task, or None if there is none that can be read."""
        try:
            record = record_of((self.runs / key / RECORD).read_bytes())
        except (OSError, ValueError):  # no record, or a key that is no file name
            return None
        return record if record.key == key else None

    def damaged_file(self, key: str) -> str:
        """The first NetCDF file of a stored run that is gone or has another size than it was stored with, or the list of them; empty if all are there."""
        stored = read_json(self.runs / key / FILES)
        with contextlib.suppress(OSError):  # another campaign replaces it at this moment
            there = _sizes(self.runs / key)
            if isinstance(stored, dict):
                return next((name for name, size in stored.items() if there.get(name) != size), "")
        return FILES

    def request(self, key: str) -> dict[str, Any]:
        """What was asked for in a stored task; nothing if that cannot be read."""
        return _request(self.runs / key / REQUEST)

    def discard(self, keys: Iterable[str]) -> None:
        """Delete stored runs. A campaign that is killed meanwhile leaves the others as they were."""
        for key in keys:
            shutil.rmtree(self.runs / key, ignore_errors=True)

    def requests(self) -> Iterator[dict[str, Any]]:
        """What was asked for in each stored task that can be read."""
        yield from filter(None, map(_request, sorted(self.runs.glob(f"[!.]*/{REQUEST}"))))

    def open_partial(self, key: str, token: str) -> Path:
        """A new folder for a task that is about to run. token: what its own begins with, at most 16 letters and digits."""
        folder = self.runs / aside_name(key[:12], (token + uuid.uuid4().hex)[:_TOKEN])
        with refusals_in_words(folder):
            folder.mkdir()
        return folder

    def commit(self, partial: Path, key: str) -> Path:
        """Make a partial folder durable and give it its name.

        An older run of the same key is replaced.
        """
        target, old = self.runs / key, partial.with_name(f"{partial.name}{_OLD}")
        try:
            (partial / FILES).write_text(json.dumps(_sizes(partial)), encoding="utf-8")
            fsync_whole(partial)
            while not renamed(partial, target):
                shutil.rmtree(old, ignore_errors=True)
                with contextlib.suppress(
                    FileNotFoundError
                ):  # another campaign replaces it at this moment
                    os.rename(target, old)
            fsync(self.runs)
        except OSError as error:
            with contextlib.suppress(
                OSError
            ):  # the older run, if it is aside and nothing is in its place
                os.rename(old, target)
            if target.exists():
                shutil.rmtree(old, ignore_errors=True)
            raise disk_error(target, error) from error
        shutil.rmtree(old, ignore_errors=True)
        return target


def _sizes(folder: Path) -> dict[str, int]:
    """Name of each NetCDF file in a folder -> bytes."""
    return {
        path.name: path.stat().st_size for path in sorted(folder.glob("*.nc")) if path.is_file()
    }


def _request(path: Path) -> dict[str, Any]:
    content = read_json(path)
    task = content.get("task") if isinstance(content, dict) else None
    return task if isinstance(task, dict) else {}


def _owner_lives(name: str) -> bool:
    """Whether the process that is at work on something unfinished may still be at work: a living one here, or any on another machine."""
    parts = name.split("-", 4)
    if len(parts) < 5 or not parts[3].isdigit():
        return False
    if parts[4].removesuffix(_OLD) != socket.gethostname():
        return True
    import psutil  # 8 ms, of 270 for `show`

    return psutil.pid_exists(int(parts[3]))
