"""CheckRecord: what is stored of a check, which is no scene x pipeline - a question with an expected answer, and what was found.

record = record_of(path.read_bytes())      # a RunRecord or a CheckRecord
runs, checks = divided(records)

ChartRecord: the data of one plot that a check draws itself - curves on two axes, and how to read
    them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Discriminator, RootModel, Tag

from reports.records.record import (
    SCHEMA_VERSION,
    Finite,
    MetricRecord,
    Model,
    ProvenanceRecord,
    RunRecord,
)


class AxisRecord(Model):
    """An axis of a chart; log: whether it is logarithmic."""

    quantity: str
    unit: str = ""
    log: bool = False


class SeriesRecord(Model):
    """x, y: of equal length; line: joined, else points alone."""

    name: str
    x: tuple[Finite, ...]
    y: tuple[Finite, ...]
    line: bool = True


class ChartRecord(Model):
    """level: a horizontal line, with its words; words: what the plot shows, as a sentence."""

    title: str
    x: AxisRecord
    y: AxisRecord
    series: tuple[SeriesRecord, ...]
    level: Finite | None = None
    level_words: str = ""
    words: str = ""


class CheckRow(Model):
    """One check of an FMU: what it claims of a sound one, and what was found.

    type: "ME", "CS", or nothing for the file; clause: the section of the standard that demands it,
        or nothing; severity: what a failure of it is, or nothing where that is not known.
    """

    name: str
    type: str
    claim: str
    status: Literal["passed", "failed", "not offered", "advice", "waived"]
    sentence: str
    seconds: Finite
    clause: str = ""
    severity: Literal["", "error", "behaviour", "advice"] = ""


class FmuRecord(Model):
    """An FMU that was exported and checked. version: of FMI, as it says itself; types: ME, CS.

    export_seconds: little if it was kept from before.
    """

    version: str
    types: tuple[str, ...]
    bytes: int
    sha256: str
    export_seconds: Finite
    check_seconds: Finite
    rows: tuple[CheckRow, ...]

    def count(self, status: str) -> int:
        """How many checks of the FMU have this status."""
        return sum(row.status == status for row in self.rows)

    @property
    def failed(self) -> tuple[CheckRow, ...]:
        """The checks that the FMU failed."""
        return tuple(row for row in self.rows if row.status == "failed")


class CheckRecord(Model):
    """One check. kind and name together are unique in a campaign; a kind has a page of its own.

    outcome: `answered`, or how it ended without an answer (`failed`: it says itself why it could
        not; `crashed`, `time_limit`); passed: what was
    found is what was expected, never true without an answer; found, message: one sentence each,
        what was found and why there is no answer;
    fmu: what kind `FMU` found in detail; charts: data of plots it draws itself.
    """

    schema_version: Literal[9] = SCHEMA_VERSION
    key: str
    kind: str
    name: str
    expected: str  # what a sound system does, one sentence
    scene: str | None = None  # the scene it is about, if it is about one
    outcome: str
    passed: bool
    found: str = ""
    message: str = ""
    figures: tuple[MetricRecord, ...] = ()
    fmu: FmuRecord | None = None
    charts: tuple[ChartRecord, ...] = ()
    wall_seconds: Finite
    cpu_seconds: Finite
    provenance: ProvenanceRecord
    log_tail: str = ""

    @property
    def title(self) -> str:
        """The kind and the name, by which the campaign and `show` know it."""
        return f"{self.kind}: {self.name}"


def _which(data: Any) -> str:
    """`run` has a pipeline; anything else is read as a check, which says what it lacks."""
    return (
        "run"
        if isinstance(data, RunRecord) or (isinstance(data, dict) and "pipeline" in data)
        else "check"
    )


class StoredRecord(RootModel):
    """Any record.json of a campaign."""

    root: Annotated[
        Annotated[RunRecord, Tag("run")] | Annotated[CheckRecord, Tag("check")],
        Discriminator(_which),
    ]


def record_of(text: bytes) -> RunRecord | CheckRecord:
    """The record that a record.json holds. Raises pydantic's ValidationError."""
    return StoredRecord.model_validate_json(text).root


def divided(
    records: Iterable[RunRecord | CheckRecord],
) -> tuple[tuple[RunRecord, ...], tuple[CheckRecord, ...]]:
    """Runs and checks, each in their order."""
    records = tuple(records)
    return (
        tuple(record for record in records if isinstance(record, RunRecord)),
        tuple(record for record in records if isinstance(record, CheckRecord)),
    )
