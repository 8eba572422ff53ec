"""Files of text and bytes -> a zip that has the same bytes wherever and whenever it is made."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from models.fmu.description import source_epoch


def pack(path: Path, content: Mapping[str, bytes], first: str) -> None:
    """Write `content` (name inside -> bytes) as a zip; the file `first` comes first, so that a reader of the stream finds it at once."""
    stamp = datetime.fromtimestamp(source_epoch(), UTC).timetuple()[:6]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(content, key=lambda name: (name != first, name)):
            entry = zipfile.ZipInfo(name, date_time=stamp)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            entry.create_system = 3  # Unix, whatever machine packs it
            archive.writestr(entry, content[name])
