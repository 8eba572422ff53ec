"""CheckRecord: an expected result and a finding; ChartRecord: data of one plot of a check.

record = record_of(path.read_bytes())  # a RunRecord or a CheckRecord
runs, checks = divided(records)
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
    """An axis of a chart."""

    quantity: str
    unit: str = ""
    log: bool = False


class SeriesRecord(Model):
    """x, y of equal length; line: joined points."""

    name: str
    x: tuple[Finite, ...]
    y: tuple[Finite, ...]
    line: bool = True


class ChartRecord(Model):
    """One plot; level: a horizontal line; words: its content as a sentence."""

    title: str
    x: AxisRecord
    y: AxisRecord
    series: tuple[SeriesRecord, ...]
    level: Finite | None = None
    level_words: str = ""
    words: str = ""


class CheckRow(Model):
    """One check of an FMU: its claim and the finding.

    - type: "ME", "CS", or "" for the file.
    - clause: section of the standard.
    - severity: of a failure, "" if unknown.
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
    """An exported and checked FMU; version: of FMI; types: ME, CS; export may be cached."""

    version: str
    types: tuple[str, ...]
    bytes: int
    sha256: str
    export_seconds: Finite
    check_seconds: Finite
    rows: tuple[CheckRow, ...]

    def count(self, status: str) -> int:
        """Return the number of checks with this status."""
        return sum(row.status == status for row in self.rows)

    @property
    def failed(self) -> tuple[CheckRow, ...]:
        """Return the failed checks."""
        return tuple(row for row in self.rows if row.status == "failed")


class CheckRecord(Model):
    """One check; kind and name are unique in a campaign, and a kind has its page.

    - outcome: `answered`, or how it ended: `failed` with a reason, `crashed`, `time_limit`.
    - passed: the finding is as expected.
    - found, message: sentences of the finding, and of a missing answer.
    - fmu: details of kind `FMU`.
    - charts: data of plots.
    """

    schema_version: Literal[9] = SCHEMA_VERSION
    key: str
    kind: str
    name: str
    expected: str  # correct behaviour, in one sentence
    scene: str | None = None  # its scene, if any
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
        """Return kind and name, as in campaigns and `show`."""
        return f"{self.kind}: {self.name}"


def _which(data: Any) -> str:
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
    """Return the record of a record.json. Raises pydantic's ValidationError."""
    return StoredRecord.model_validate_json(text).root


def divided(
    records: Iterable[RunRecord | CheckRecord],
) -> tuple[tuple[RunRecord, ...], tuple[CheckRecord, ...]]:
    """Return runs and checks, each in their order."""
    records = tuple(records)
    return (
        tuple(record for record in records if isinstance(record, RunRecord)),
        tuple(record for record in records if isinstance(record, CheckRecord)),
    )
