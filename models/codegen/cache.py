"""A content-addressed cache: $TOUCHSTONE_CACHE, or `touchstone` in the user's cache folder."""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from models.errors import MachineError

# Temporary names: building-<process>-<host>-<random>.
_BUILDING = "building-"


def _place() -> Path:
    folder = os.environ.get("TOUCHSTONE_CACHE")
    if folder:
        return Path(folder).absolute()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "touchstone"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "touchstone"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchstone"


def cache_folder() -> Path:
    """Return the cache folder, created if needed; raise MachineError if it is not writable."""
    folder = _place()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MachineError(
            f"the cache folder {folder} cannot be created ({error.strerror}); set TOUCHSTONE_CACHE to a folder you can write."
        ) from error
    if not os.access(folder, os.W_OK):
        raise MachineError(
            f"the cache folder {folder} cannot be written; set TOUCHSTONE_CACHE to a folder you can write."
        )
    return folder


def _remove_leftovers(folder: Path) -> None:
    import psutil

    for leftover in folder.glob(f"{_BUILDING}*"):
        number, _, rest = leftover.name.removeprefix(_BUILDING).partition("-")
        if (
            rest.rpartition("-")[0] == socket.gethostname()
            and number.isdigit()
            and not psutil.pid_exists(int(number))
        ):
            shutil.rmtree(leftover, ignore_errors=True)


def cached(key_text: str, suffix: str, build: Callable[[Path], object]) -> Path:
    """Return the file for this content; if it does not exist, `build(path)` it and rename it.

    An existing file is found in a read-only folder too. Concurrent builds are safe. Raises
    MachineError for errors of the disk.
    """
    key = hashlib.sha256(key_text.encode()).hexdigest()
    target = _place() / f"{key[:32]}{suffix}"
    if target.exists():
        return target
    cache_folder()
    _remove_leftovers(target.parent)
    try:
        with tempfile.TemporaryDirectory(
            dir=target.parent, prefix=f"{_BUILDING}{os.getpid()}-{socket.gethostname()}-"
        ) as folder:
            made = Path(folder) / target.name
            build(made)
            os.replace(made, target)
    except OSError as error:
        raise MachineError(
            f"the cache folder {target.parent} cannot be written ({error}); set TOUCHSTONE_CACHE to another folder."
        ) from error
    return target
