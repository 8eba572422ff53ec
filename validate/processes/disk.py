"""Atomic file operations, with one sentence if the disk refuses."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from models.errors import MachineError

# Prefix of unfinished files and folders.
PARTIAL = ".partial-"
# Errors of a disk that accepts no writes, unlike programming errors.
_DISK_REFUSES = frozenset(
    {
        errno.EACCES,
        errno.EPERM,
        errno.EROFS,
        errno.ENOSPC,
        errno.EDQUOT,
        errno.EIO,
        errno.EFBIG,
        errno.ENOTDIR,
    }
)
# Errors that a method or check never causes itself.
_DISK_ENDS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})


def disk_error(path: Path, error: OSError) -> MachineError:
    """Return the error of a disk that refuses, in one sentence."""
    what = (
        "the disk is full"
        if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
        else (error.strerror or str(error)).lower()
    )
    if error.errno == errno.ENOENT and not path.parent.exists():
        return MachineError(
            f"cannot write {path} (its folder is gone): it was removed or moved, or its disk is gone."
        )
    return MachineError(
        f"cannot write {path} ({what}); make room or permit it, or write elsewhere."
    )


@contextmanager
def refusals_in_words(path: Path) -> Iterator[None]:
    """Turn an OSError of the block into a MachineError about this path."""
    try:
        yield
    except OSError as error:
        raise disk_error(path, error) from error


def disk_refuses(error: OSError) -> bool:
    """Return whether the disk accepts no writes, as opposed to a programming error."""
    return error.errno in _DISK_REFUSES


def raise_if_disk_ended(path: Path, error: BaseException) -> None:
    """Raise MachineError if the cause of an error is a full or broken disk; path: a default."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _DISK_ENDS:
            raise disk_error(
                Path(cause.filename) if isinstance(cause.filename, str) else path, cause
            ) from error
        cause = cause.__cause__ or cause.__context__


def remove(path: Path) -> None:
    """Remove a file if it exists. Raises MachineError if the disk refuses."""
    with refusals_in_words(path):
        path.unlink(missing_ok=True)


def no_temporary_folder(error: OSError) -> MachineError:
    """Return the error of a machine without a temporary folder, in one sentence."""
    where = f": {error.filename}" if error.filename else ""
    return MachineError(
        f"no temporary folder can be made ({error.strerror or error}{where}); make room or set TMPDIR to a folder you can write."
    )


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Create a folder for the block. Raises MachineError if that fails."""
    try:
        folder = tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True)
    except OSError as error:
        raise no_temporary_folder(error) from error
    try:
        yield Path(folder.name)
    finally:
        with contextlib.suppress(
            OSError
        ):  # files of another user raise despite ignore_cleanup_errors
            folder.cleanup()


def make_folder(path: Path) -> None:
    """Make a folder and its parents. Raises MachineError if the disk refuses."""
    with refusals_in_words(path):
        path.mkdir(parents=True, exist_ok=True)


def write_durably(path: Path, content: str | bytes) -> None:
    """Write a file atomically: it has the old or the new content. Raises MachineError."""
    unfinished = path.with_name(aside_name("file", uuid.uuid4().hex))
    try:
        with open(unfinished, "wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except BaseException as error:  # Ctrl-C, too, must leave nothing
        with contextlib.suppress(OSError):
            unfinished.unlink()
        if isinstance(error, OSError):
            raise disk_error(path, error) from error
        raise


def fsync(path: Path) -> None:
    """Sync a file or folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_whole(folder: Path) -> None:
    """Sync a folder and its files to the disk."""
    for path in (*sorted(folder.iterdir()), folder):
        fsync(path)


def renamed(folder: Path, target: Path) -> bool:
    """Rename a folder; return False if the target exists. Raises OSError if the disk refuses."""
    try:
        os.rename(folder, target)
    except OSError as error:
        if error.errno in {errno.ENOTEMPTY, errno.EEXIST}:
            return False
        raise
    return True


def tail(path: Path, size: int) -> str:
    """Return the last `size` bytes of a file as text, "" if unreadable."""
    with contextlib.suppress(OSError), open(path, "rb") as file:
        file.seek(max(0, os.path.getsize(path) - size))
        return file.read().decode("utf-8", errors="replace")
    return ""


def read_json(path: Path) -> Any:
    """Return the content of a JSON file, None if missing or damaged."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        return json.loads(path.read_text(encoding="utf-8"))
    return None


def aside_name(what: str, token: str) -> str:
    """Return a name for an unfinished file or folder, with its owner."""
    return f"{PARTIAL}{what}-{token}-{os.getpid()}-{socket.gethostname()}"
