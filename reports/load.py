"""Read the records of a campaign's folder; unreadable ones are listed with reasons.

stored = load(Path("runs/all"))
stored.campaign, stored.runs, stored.unreadable, stored.missing
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from models.results.check import CheckRecord, divided
from models.results.run import SCHEMA_VERSION, CampaignRecord, RunRecord
from models.results.stored import from_json, record_of
from models.results.verdict import HOLD
from reports.wording import clean

CAMPAIGN = "campaign.json"
# Ten times the largest conceivable record [bytes].
LARGEST_BYTES = 64 * 1024 * 1024


def record_files(folder: Path) -> list[Path]:
    """Return the path of record.json of each run, sorted by key; files may be missing."""
    runs = folder / "runs"
    if not runs.is_dir():
        return []
    # Names with a leading dot or .tmp are runs being written.
    folders = sorted(
        path
        for path in runs.iterdir()
        if path.is_dir() and not path.name.startswith(".") and path.suffix != ".tmp"
    )
    return [path / "record.json" for path in folders]


_Record = TypeVar("_Record")


class ReportError(Exception):
    """The report cannot be written; one sentence has the reason and an advice."""


@dataclass(frozen=True)
class Unreadable:
    """An unusable file, relative to the campaign's folder, and the reason."""

    path: str
    sentence: str


@dataclass(frozen=True)
class Stored:
    """Content of a report.

    missing: listed keys without a record; foreign: number of records that are not listed.
    """

    campaign: CampaignRecord | None
    runs: tuple[RunRecord, ...]
    unreadable: tuple[Unreadable, ...] = ()
    missing: tuple[str, ...] = ()
    foreign: int = 0
    checks: tuple[CheckRecord, ...] = ()

    def cheapest(self, scene: str) -> list[tuple[RunRecord, float]]:
        """Return the runs of a scene that hold, with their costs, the cheapest first."""
        priced = [
            (run, run.cost)
            for run in self.runs
            if run.scene.name == scene and run.verdict in HOLD and run.stages
        ]
        return sorted(
            ((run, price) for run, price in priced if price is not None), key=lambda pair: pair[1]
        )


def load(folder: Path) -> Stored:
    """Return all readable records, in the campaign's order.

    Raises ReportError without a folder, or for one of another version of touchstone.
    """
    if not folder.is_dir():
        raise ReportError(
            f"{folder}: there is no such folder; give the folder of a campaign (it holds campaign.json and runs/)."
        )
    if sentence := other_version(folder):
        raise ReportError(sentence)
    unreadable: list[Unreadable] = []
    campaign = read_record(
        folder / CAMPAIGN, folder, lambda text: from_json(CampaignRecord, text), unreadable
    )
    records: dict[str, RunRecord | CheckRecord] = {}
    for path in record_files(folder):
        run = read_record(path, folder, record_of, unreadable)
        if run is None:
            continue
        if run.key != path.parent.name:
            sentence = f"it says that it is the record of {run.key[:40]!r}, but lies in the folder of another; run it again."
            unreadable.append(Unreadable(clean(str(path.relative_to(folder))), clean(sentence)))
            continue
        records[run.key] = run
    if campaign is None:
        runs, checks = divided(records.values())
        runs = sorted(runs, key=lambda run: (run.scene.name, run.pipeline, run.key))
        checks = tuple(sorted(checks, key=lambda item: (item.kind, item.name)))
        return Stored(
            None,
            tuple(runs),
            tuple(unreadable),
            checks=checks,
        )
    keys = list(dict.fromkeys(campaign.keys))
    runs, checks = divided(records[key] for key in keys if key in records)
    broken = {Path(item.path).parent.name for item in unreadable}
    return Stored(
        campaign=campaign,
        runs=runs,
        unreadable=tuple(unreadable),
        missing=tuple(
            clean(key) for key in keys if key not in records and clean(key) not in broken
        ),
        foreign=len(set(records) - set(keys)),
        checks=checks,
    )


def other_version(folder: Path) -> str:
    """Return why a folder of another version of touchstone is refused, or ""."""
    content = None
    with contextlib.suppress(OSError, ValueError, RecursionError, ReportError):
        content = json.loads(_text(folder / CAMPAIGN))
    if (
        not isinstance(content, dict)
        or content.get("schema_version", SCHEMA_VERSION) == SCHEMA_VERSION
    ):
        return ""
    return f"{folder}: this store was written by another version of touchstone; use another --out folder or delete it."


def read_record(
    path: Path, folder: Path, read: Callable[[bytes], _Record], unreadable: list[Unreadable]
) -> _Record | None:
    """Return the content of a file, or None with a reason added to `unreadable`."""
    try:
        return read(_text(path))
    except ReportError as problem:
        sentence = str(problem)
    except OSError as problem:
        sentence = f"it cannot be read ({problem.strerror or type(problem).__name__})."
    except ValidationError as problem:
        sentence = _validation_sentence(problem)
    unreadable.append(Unreadable(clean(str(path.relative_to(folder))), clean(sentence)))
    return None


def _text(path: Path) -> bytes:
    if not path.is_file():
        raise ReportError(
            "it is not there; the run was interrupted or the file was removed: run the campaign again to fill it."
        )
    if path.stat().st_size > LARGEST_BYTES:
        raise ReportError(
            f"it is larger than {LARGEST_BYTES // 1024 // 1024} MB, so it is not a record of this program."
        )
    return path.read_bytes()


def _validation_sentence(problem: ValidationError) -> str:
    first = problem.errors(include_url=False, include_context=False, include_input=False)[0]
    more = problem.error_count() - 1
    place = ".".join(str(part) for part in first["loc"])[:120]
    if first["type"] == "json_invalid":
        return f"it is not complete JSON ({first['msg']}); the file was cut short or edited: run it again."
    where = f"at {place}: " if place else ""
    others = f", and {more} more" if more else ""
    return f"it does not follow record schema {SCHEMA_VERSION} ({where}{first['msg']}{others}); written by another version, or edited: run it again."
