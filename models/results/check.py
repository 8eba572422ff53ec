"""CheckRecord: an expected result and a finding; ChartRecord: data of one plot of a check.

runs, checks = divided(records)  # RunRecords and CheckRecords
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from models.results.fields import Result
from models.results.run import SCHEMA_VERSION, ProvenanceRecord, RunRecord
from models.results.verdict import Metric


@dataclass(frozen=True, kw_only=True)
class AxisRecord(Result):
    """An axis of a chart."""

    quantity: str
    unit: str = ""
    log: bool = False


@dataclass(frozen=True, kw_only=True)
class SeriesRecord(Result):
    """x, y of equal length; line: joined points."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    line: bool = True


@dataclass(frozen=True, kw_only=True)
class ChartRecord(Result):
    """One plot; level: a horizontal line; words: its content as a sentence."""

    title: str
    x: AxisRecord
    y: AxisRecord
    series: tuple[SeriesRecord, ...]
    level: float | None = None
    level_words: str = ""
    words: str = ""


class Status(StrEnum):
    """The outcome of a check, as the table shows it."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_OFFERED = "not offered"  # the FMU does not offer the feature, or it cannot be measured
    ADVICE = "advice"  # allowed, and a trap for users
    WAIVED = "waived"  # failed, and the user gave a reason why that is right


@dataclass(frozen=True, kw_only=True)
class FmuCheckRow(Result):
    """One check of an FMU: its claim and the finding.

    - type: of FMI, "ME" or "CS"; "" for the file.
    - clause: section of the standard.
    """

    name: str
    type: str
    claim: str
    status: Status
    sentence: str
    seconds: float
    clause: str = ""

    @property
    def title(self) -> str:
        """Return the name of the check, with the type of FMI."""
        return f"{self.name} ({self.type})" if self.type else self.name

    @property
    def severity(self) -> str:
        """Return `error` if the standard demands it, else `behaviour`; `advice` for advice."""
        return "advice" if self.status is Status.ADVICE else "error" if self.clause else "behaviour"


@dataclass(frozen=True, kw_only=True)
class FmuRecord(Result):
    """An exported and checked FMU; version: of FMI; types: ME, CS; export may be cached."""

    version: str
    types: tuple[str, ...]
    bytes: int
    sha256: str
    export_seconds: float
    check_seconds: float
    rows: tuple[FmuCheckRow, ...]

    def count(self, status: str) -> int:
        """Return the number of checks with this status."""
        return sum(row.status == status for row in self.rows)

    @property
    def failed(self) -> tuple[FmuCheckRow, ...]:
        """Return the failed checks."""
        return tuple(row for row in self.rows if row.status is Status.FAILED)


@dataclass(frozen=True, kw_only=True)
class CheckRecord(Result):
    """One check; kind and name are unique in a campaign, and a kind has its page.

    - outcome: `answered`, or how it ended: `failed` with a reason, `crashed`, `time_limit`.
    - passed: the finding is as expected.
    - found, message: sentences of the finding, and of a missing answer.
    - fmu: details of kind `FMU`.
    - charts: data of plots.
    """

    schema_version: Literal[10] = SCHEMA_VERSION
    key: str
    kind: str
    name: str
    expected: str  # correct behaviour, in one sentence
    scene: str | None = None  # its scene, if any
    outcome: str
    passed: bool
    found: str = ""
    message: str = ""
    figures: tuple[Metric, ...] = ()
    fmu: FmuRecord | None = None
    charts: tuple[ChartRecord, ...] = ()
    wall_seconds: float
    cpu_seconds: float
    provenance: ProvenanceRecord
    log_tail: str = ""

    @property
    def title(self) -> str:
        """Return kind and name, as in campaigns and `show`."""
        return f"{self.kind}: {self.name}"


def divided(
    records: Iterable[RunRecord | CheckRecord],
) -> tuple[tuple[RunRecord, ...], tuple[CheckRecord, ...]]:
    """Return runs and checks, each in their order."""
    records = tuple(records)
    return (
        tuple(record for record in records if isinstance(record, RunRecord)),
        tuple(record for record in records if isinstance(record, CheckRecord)),
    )
