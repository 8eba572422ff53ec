"""What was told of a campaign, kept beside it: told again at once while everything it is made of is the same, byte by byte.

    text = kept(folder, "report", lambda: render(folder))          keeps the text in DIR/.report.kept

The first line of the file holds two digests: of all that goes into the text - campaign, records, the folder's name, the files of this
room, the versions of what it stands on - and of the text itself. One that does not fit, for whatever reason, is as none: it may be removed at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import socket
import time
import uuid
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path

from reports.records.load import LARGEST_BYTES, record_files

_HERE = Path(__file__).parent
# A change of one of these may change a text.
_LIBRARIES = ("jinja2", "markupsafe", "numpy", "pydantic", "pydantic-core")

# Changes closer to one another than this may carry the same time [ns].
_TICK = 2_000_000_000


def kept(folder: Path, name: str, make: Callable[[], str], *, sources: Iterable[Path] = ()) -> str:
    """The text that `make` makes of a campaign's folder; sources: files outside this room that decide it too. Raises what `make` raises."""
    sources = tuple(sources)
    seen, began = _stamps(folder, sources), time.time_ns()
    content = content_digest(folder, sources)
    if content is None:
        return make()
    place = folder / f".{name}.kept"
    found = _read(place, content)
    if found is not None:
        return found
    text = make()
    settled = bool(seen) and seen == _stamps(folder, sources) and max(seen.values())[0] < began - _TICK
    if settled or content_digest(folder, sources) == content:  # nothing was written into the folder meanwhile
        _write(place, content, text)
    return text


def _stamps(folder: Path, sources: Iterable[Path]) -> dict[Path, tuple[int, ...]]:
    """Of each file that decides a text about this folder, when it was last changed, which nobody can set, and what it is; none where it cannot
    be said."""
    try:
        told = {path: path.stat() for path in (*_of_folder(folder), *sources, *_of_room()) if path.exists()}
    except OSError:
        return {}
    return {path: (stat.st_ctime_ns, stat.st_mtime_ns, stat.st_ino, stat.st_size) for path, stat in told.items()}


def content_digest(folder: Path, sources: Iterable[Path] = ()) -> str | None:
    """Digest of all that a text about this folder is made of; None where something cannot be read."""
    whole = hashlib.sha256()
    try:
        said = [folder.name, code_digest(), *(f"{path} {_digest(path)}" for path in sources)]
        said += [f"{path.relative_to(folder)} {_digest(path)}" for path in _of_folder(folder)]
    except OSError:
        return None
    for text in said:
        whole.update(text.encode("utf-8", "surrogateescape") + b"\0")
    return whole.hexdigest()


def _of_folder(folder: Path) -> list[Path]:
    return [folder / "campaign.json", *record_files(folder)]


def _of_room() -> list[Path]:
    return sorted(path for path in _HERE.rglob("*") if path.is_file() and "__pycache__" not in path.parts)


def code_digest() -> str:
    """Digest of the files of this room and of the versions of what it stands on. Raises OSError."""
    said = [
        platform.python_version(),
        *(f"{name} {_version(name)}" for name in _LIBRARIES),
        *(f"{path} {_digest(path)}" for path in _of_room()),
    ]
    return hashlib.sha256("\0".join(said).encode("utf-8", "surrogateescape")).hexdigest()


def _digest(path: Path) -> str:
    """Of what is in a file; what is no file, or too large to be read, is told as that."""
    if not path.is_file():
        return "absent"
    if path.stat().st_size > LARGEST_BYTES:
        return "large"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _read(place: Path, content: str) -> str | None:
    try:
        head, _, body = place.read_bytes().partition(b"\n")
        if head.decode("ascii").split() == [content, hashlib.sha256(body).hexdigest()]:
            return body.decode("utf-8")
    except (OSError, ValueError):  # none, or damaged
        pass
    return None


def _write(place: Path, content: str, text: str) -> None:
    """Whole or not at all; a folder that takes nothing more is no reason to fail."""
    body = text.encode("utf-8", errors="replace")
    part = place.with_name(f".partial-kept-{uuid.uuid4().hex}-{os.getpid()}-{socket.gethostname()}")
    try:
        part.write_bytes(f"{content} {hashlib.sha256(body).hexdigest()}\n".encode() + body)
        os.replace(part, place)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
