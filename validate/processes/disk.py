"""Files on a disk that may be full, read-only or gone: written whole or not at all, and one sentence where it refuses."""

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

# How the name of what is not finished begins.
PARTIAL = ".partial-"
# What the operating system says when a disk will take no more, as opposed to a mistake of ours.
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
# Of these, what no method and no check does by a mistake of its own.
_DISK_ENDS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})


def disk_error(path: Path, error: OSError) -> MachineError:
    """One sentence for a disk that refuses."""
    what = (
        "the disk is full"
        if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
        else (error.strerror or str(error)).lower()
    )
    if error.errno == errno.ENOENT and not path.parent.exists():
        return MachineError(
            f"cannot write {path} (its folder is gone); somebody removed or moved it, or its disk is no longer there."
        )
    return MachineError(
        f"cannot write {path} ({what}); make room or permit it, or write elsewhere."
    )


@contextmanager
def refusals_in_words(path: Path) -> Iterator[None]:
    """What is done to a file or folder here.

    Where the disk refuses, a MachineError says so of it.
    """
    try:
        yield
    except OSError as error:
        raise disk_error(path, error) from error


def disk_refuses(error: OSError) -> bool:
    """Whether the disk will take no more, as opposed to a mistake of ours."""
    return error.errno in _DISK_REFUSES


def raise_if_disk_ended(path: Path, error: BaseException) -> None:
    """Raise a MachineError if what went wrong in a task, or what it came of, is a disk that takes no more. path: named where the error names none."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _DISK_ENDS:
            raise disk_error(
                Path(cause.filename) if isinstance(cause.filename, str) else path, cause
            ) from error
        cause = cause.__cause__ or cause.__context__


def remove(path: Path) -> None:
    """Remove a file if it is there. Raises MachineError where the disk refuses."""
    with refusals_in_words(path):
        path.unlink(missing_ok=True)


def no_temporary_folder(error: OSError) -> MachineError:
    """One sentence for a machine on which no temporary folder can be made."""
    where = f": {error.filename}" if error.filename else ""
    return MachineError(
        f"no temporary folder can be made ({error.strerror or error}{where}); make room or set TMPDIR to a folder you can write."
    )


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A folder that is gone afterwards. Raises MachineError where none can be made."""
    try:
        folder = tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True)
    except OSError as error:
        raise no_temporary_folder(error) from error
    try:
        yield Path(folder.name)
    finally:
        with contextlib.suppress(
            OSError
        ):  # of another user's files, which foreign code may have left, it is not silent all the same
            folder.cleanup()


def make_folder(path: Path) -> None:
    """Make a folder and those it lies in. Raises MachineError where the disk refuses."""
    with refusals_in_words(path):
        path.mkdir(parents=True, exist_ok=True)


def write_durably(path: Path, content: str | bytes) -> None:
    """Write a file so that after this call either the old or the new content is there, whatever happens. Raises MachineError."""
    unfinished = path.with_name(aside_name("file", uuid.uuid4().hex))
    try:
        with open(unfinished, "wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except BaseException as error:  # Ctrl-C too leaves nothing
        with contextlib.suppress(OSError):
            unfinished.unlink()
        if isinstance(error, OSError):
            raise disk_error(path, error) from error
        raise


def fsync(path: Path) -> None:
    """Have a file or folder on the disk before this returns."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_whole(folder: Path) -> None:
    """Have a folder of files on the disk before this returns."""
    for path in (*sorted(folder.iterdir()), folder):
        fsync(path)


def renamed(folder: Path, target: Path) -> bool:
    """Whether a folder has its name now; not if there is one of that name.

    Raises OSError where the disk refuses.
    """
    try:
        os.rename(folder, target)
    except OSError as error:
        if error.errno in {errno.ENOTEMPTY, errno.EEXIST}:
            return False
        raise
    return True


def tail(path: Path, size: int) -> str:
    """The last `size` bytes of a file, as text; empty where it cannot be read."""
    with contextlib.suppress(OSError), open(path, "rb") as file:
        file.seek(max(0, os.path.getsize(path) - size))
        return file.read().decode("utf-8", errors="replace")
    return ""


def read_json(path: Path) -> Any:
    """What a file of JSON holds; None where it is not there or damaged."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        return json.loads(path.read_text(encoding="utf-8"))
    return None


def aside_name(what: str, token: str) -> str:
    """The name of what is not finished; it says whose it is."""
    return f"{PARTIAL}{what}-{token}-{os.getpid()}-{socket.gethostname()}"
