"""Outlines of records - all but their traces, which are nine tenths of them - and the sections of their runs, both kept by content.

    outlines = Outlines(folder, lambda run: written(templates, run))
    stored = load(folder, outlines.read);  outlines.article(stored.parts[0])  ->  the section of the first run, with its plots
    outlines.whole(stored.parts[0])        the run with its traces

What was read once is told again from DIR/.told as long as the record is the same, byte by byte, and so is the program that tells it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from pydantic import ValidationError

from reports.article import Article
from reports.collected import collected
from reports.records.check_record import ExaminationRecord, record_of
from reports.records.load import ReportError
from reports.records.record import RunRecord
from reports.shelf import Shelf

_TRACES = {"plan_trace": None, "replay_trace": None, "tracked_trace": None, "history": {}}
# Stands in no JSON.
_BETWEEN = "\0"


class Outlines:
    """Reads records as outlines; `write` makes the section of a run from its whole record."""

    def __init__(self, folder: Path, write: Callable[[RunRecord], Article]) -> None:
        self.shelf = Shelf(folder)
        self._folder, self._write = folder, write
        self._read: dict[int, tuple[RunRecord, str, Article | None]] = {}

    def read(self, text: bytes) -> RunRecord | ExaminationRecord:
        """The outline of a run, or an examination as it is. Raises pydantic's ValidationError."""
        digest = hashlib.sha256(text).hexdigest()
        found = self._kept(digest)
        if found is None:
            found = self._outlined(record_of(text))
            record, article = found
            self.shelf.put(record.model_dump_json() + _BETWEEN + (article.to_json() if article else ""), "record", digest)
        record, article = found
        if isinstance(record, RunRecord):
            self._read[id(record)] = (record, digest, article)
        return record

    def article(self, parts: Sequence[RunRecord]) -> Article:
        """The section of a run; parts: the outlines of its cells. Raises ReportError where a record is no longer as it was read."""
        single = self._read[id(parts[0])][2]
        if single is not None:
            return single
        text = self.shelf.kept(lambda: self._write(self.whole(parts)).to_json(), "parts", *map(self.digest, parts))
        return Article.from_json(text)

    def digest(self, outline: RunRecord) -> str:
        """Of the record's file."""
        return self._read[id(outline)][1]

    def whole(self, parts: Sequence[RunRecord]) -> RunRecord:
        """The run with its traces. Raises ReportError."""
        return collected(self._whole(part) for part in parts)[0]

    def _whole(self, outline: RunRecord) -> RunRecord:
        path = self._folder / "runs" / outline.key / "record.json"
        try:
            text = path.read_bytes()
            record = record_of(text)
        except (OSError, ValidationError):
            text, record = b"", None
        if not isinstance(record, RunRecord) or hashlib.sha256(text).hexdigest() != self.digest(outline):
            raise ReportError(f"{path}: it was changed while the report was written; write the report again.")
        return record

    def _kept(self, digest: str) -> tuple[RunRecord | ExaminationRecord, Article | None] | None:
        text = self.shelf.text("record", digest)
        if text is None:
            return None
        record, _, article = text.partition(_BETWEEN)
        return record_of(record.encode()), Article.from_json(article) if article else None

    def _outlined(self, record: RunRecord | ExaminationRecord) -> tuple[RunRecord | ExaminationRecord, Article | None]:
        if not isinstance(record, RunRecord):
            return record, None
        outline = record.model_copy(update={"stages": tuple(stage.model_copy(update=_TRACES) for stage in record.stages)})
        return outline, self._write(record) if record.parts == 1 else None
