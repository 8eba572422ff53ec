"""The files of a campaign's folder that are told of."""

from __future__ import annotations

from pathlib import Path

# A record holds thinned traces only: 64 MB is ten times the largest thinkable one, and what is larger is not a record.
LARGEST_BYTES = 64 * 1024 * 1024


def record_files(folder: Path) -> list[Path]:
    """record.json of each run, sorted by key; it need not be there."""
    runs = folder / "runs"
    if not runs.is_dir():
        return []
    # Folders whose name begins with a dot or ends in .tmp are runs that are being written.
    folders = sorted(path for path in runs.iterdir() if path.is_dir() and not path.name.startswith(".") and path.suffix != ".tmp")
    return [path / "record.json" for path in folders]
