"""A folder of things built once: content-addressed, so that it never needs cleaning to be right.

The folder is $TOUCHSTONE_CACHE, or `touchstone` in the user's cache folder.
"""

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

# What is being built, and by whom: building-<process>-<host>-<random>.
_BUILDING = "building-"


def _place() -> Path:
    given = os.environ.get("TOUCHSTONE_CACHE")
    if given:
        return Path(given).absolute()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "touchstone"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "touchstone"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchstone"


def cache_folder() -> Path:
    """The cache folder, created if needed. Raises MachineError if it cannot be written."""
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


def _remove_what_the_dead_left(folder: Path) -> None:
    """Of processes of this machine alone: those of another cannot be looked up here."""
    import psutil

    for left in folder.glob(f"{_BUILDING}*"):
        number, _, rest = left.name.removeprefix(_BUILDING).partition("-")
        if (
            rest.rpartition("-")[0] == socket.gethostname()
            and number.isdigit()
            and not psutil.pid_exists(int(number))
        ):
            shutil.rmtree(left, ignore_errors=True)


def cached(key_text: str, suffix: str, build: Callable[[Path], object]) -> Path:
    """The file for this content: found, be it in a folder that cannot be written, or made by `build(path)` in a temporary place and renamed.

    Two processes may build the same file at once; both end with a whole one. What a process left
    that was killed while it built goes with the next one that builds. Raises MachineError when the
    disk refuses.
    """
    key = hashlib.sha256(key_text.encode()).hexdigest()
    target = _place() / f"{key[:32]}{suffix}"
    if target.exists():
        return target
    cache_folder()
    _remove_what_the_dead_left(target.parent)
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
