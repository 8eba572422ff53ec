"""A benchmark that is told in tables alone."""

from __future__ import annotations

import re
from collections.abc import Sequence

from benchmarks.records import AnyRecord, TableRecord
from reports.pages.section import Section
from reports.wording import error, number

# What is smaller is a residual: two digits of it are enough.
_RESIDUAL = 1e-4


def build(records: Sequence[AnyRecord]) -> Section | None:
    """Of one record; None if no table of it has a row."""
    for record in records:
        if isinstance(record, TableRecord) and any(table.rows for table in record.tables):
            anchor = "table-" + re.sub(r"[^a-z0-9]+", "-", record.name.lower())
            return Section(
                anchor,
                record.title,
                "tables.html",
                {"record": record, "shown": _shown, "numeric": _numeric},
            )
    return None


def _shown(value: float) -> str:
    return error(value) if 0 < abs(value) < _RESIDUAL else number(value, 7)


def _numeric(column: Sequence[str | float | None]) -> bool:
    """Whether no cell of a column is a text."""
    return not any(isinstance(cell, str) for cell in column)
