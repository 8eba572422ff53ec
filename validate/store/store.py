"""Store of finished tasks: one folder per task, written aside, synced, then renamed, without locks.

    DIR/runs/<key>/record.json, trajectory.nc, replay.nc, log.txt, task.json, files.json
    DIR/runs/.partial-*                    being written
    DIR/legs/<key>/                        parts of runs (validate.tasks.leg)
    DIR/surveys/<key>.json                 robustness of their plans (validate.tasks.path)

A folder under its key is complete, even after a crash. Several campaigns may share DIR.
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
from models.results.check import CheckRecord
from models.results.run import RunRecord
from models.results.stored import record_of
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
# Names and sizes [bytes] of a run's NetCDF files, to detect missing or truncated ones.
FILES = "files.json"
# Largest part of a log that is read, from its end [bytes].
_LOG_BYTES = 1_000_000

_OLD = "-old"
# Length of the token in the name of an unfinished folder.
_TOKEN = 32


class StoreError(TouchstoneError):
    """The folder cannot be a campaign's folder."""


def progress(folder: Path, text: str) -> None:
    """Write the task's progress, for the parent of a failed task."""
    (folder / PROGRESS).write_text(text, encoding="utf-8")


def progress_in(folder: Path) -> str:
    """Return the progress of the task with this unfinished folder."""
    try:
        return (folder / PROGRESS).read_text(encoding="utf-8")
    except OSError:
        return "its start"


def log_in(folder: Path) -> str:
    """Return the end of a task's log, "" without one."""
    return tail(folder / LOG, _LOG_BYTES)


class Store:
    """The stored runs of one campaign folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs, self.legs, self.surveys = folder / "runs", folder / "legs", folder / "surveys"

    def prepare(self) -> None:
        """Create the folder, check that it is writable, and remove remains of dead campaigns.

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
            with contextlib.suppress(FileNotFoundError):  # removed by another campaign
                probe.rmdir()
        for remains in self.runs.glob(f"{PARTIAL}*"):
            if not _owner_lives(remains.name):
                if remains.name.endswith(_OLD):
                    self._put_back(remains)
                shutil.rmtree(remains, ignore_errors=True)
        for aside in (*self.folder.glob(f"{PARTIAL}*"), *self.surveys.glob(f"{PARTIAL}*")):
            if not _owner_lives(aside.name):
                with contextlib.suppress(OSError):
                    aside.unlink()

    def _put_back(self, old: Path) -> None:
        with contextlib.suppress(
            OSError, ValueError, KeyError, TypeError, RecursionError
        ):  # damaged, or already replaced
            key = json.loads((old / RECORD).read_bytes())["key"]
            if key == Path(key).name and not key.startswith("."):
                os.rename(old, self.runs / key)

    def read(self, key: str) -> RunRecord | CheckRecord | None:
        """Return the stored record of a task, None if there is no readable one."""
        try:
            record = record_of((self.runs / key / RECORD).read_bytes())
        except (OSError, ValueError):  # no record, or an invalid key
            return None
        return record if record.key == key else None

    def damaged_file(self, key: str) -> str:
        """Return the first NetCDF file that is missing or has a wrong size, or FILES, or ""."""
        stored = read_json(self.runs / key / FILES)
        with contextlib.suppress(OSError):  # being replaced by another campaign
            there = _sizes(self.runs / key)
            if isinstance(stored, dict):
                return next((name for name, size in stored.items() if there.get(name) != size), "")
        return FILES

    def request(self, key: str) -> dict[str, Any]:
        """Return the request of a stored task, empty if unreadable."""
        return _request(self.runs / key / REQUEST)

    def discard(self, keys: Iterable[str]) -> None:
        """Delete stored runs, one at a time."""
        for key in keys:
            shutil.rmtree(self.runs / key, ignore_errors=True)

    def requests(self) -> Iterator[dict[str, Any]]:
        """Yield the readable requests of stored tasks."""
        yield from filter(None, map(_request, sorted(self.runs.glob(f"[!.]*/{REQUEST}"))))

    def open_partial(self, key: str, token: str) -> Path:
        """Create a folder for a task; token: prefix of its own, at most 16 letters and digits."""
        folder = self.runs / aside_name(key[:12], (token + uuid.uuid4().hex)[:_TOKEN])
        with refusals_in_words(folder):
            folder.mkdir()
        return folder

    def commit(self, partial: Path, key: str) -> Path:
        """Sync a partial folder and rename it, replacing an older run of that key."""
        target, old = self.runs / key, partial.with_name(f"{partial.name}{_OLD}")
        try:
            (partial / FILES).write_text(json.dumps(_sizes(partial)), encoding="utf-8")
            fsync_whole(partial)
            while not renamed(partial, target):
                shutil.rmtree(old, ignore_errors=True)
                with contextlib.suppress(FileNotFoundError):  # being replaced by another campaign
                    os.rename(target, old)
            fsync(self.runs)
        except OSError as error:
            with contextlib.suppress(OSError):  # the older run, if nothing is in its place
                os.rename(old, target)
            if target.exists():
                shutil.rmtree(old, ignore_errors=True)
            raise disk_error(target, error) from error
        shutil.rmtree(old, ignore_errors=True)
        return target


def _sizes(folder: Path) -> dict[str, int]:
    return {
        path.name: path.stat().st_size for path in sorted(folder.glob("*.nc")) if path.is_file()
    }


def _request(path: Path) -> dict[str, Any]:
    content = read_json(path)
    task = content.get("task") if isinstance(content, dict) else None
    return task if isinstance(task, dict) else {}


def _owner_lives(name: str) -> bool:
    """Return whether the owner of an unfinished folder may live, here or on another machine."""
    parts = name.split("-", 4)
    if len(parts) < 5 or not parts[3].isdigit():
        return False
    if parts[4].removesuffix(_OLD) != socket.gethostname():
        return True
    import psutil  # 8 ms of the 270 ms of `show`

    return psutil.pid_exists(int(parts[3]))
