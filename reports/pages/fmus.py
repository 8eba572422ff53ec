"""FMUs under the check: those of a campaign, a row a scene and version of FMI, or anybody's; and every check of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.pages.section import Report, Section
from reports.records.check_record import IMPORTER, CheckRecord, CheckRow, by_importer
from reports.wording import count, listing

KIND = "FMU"
STATUSES = ("passed", "failed", "not offered")
# Told where there are some.
RARE = ("advice", "waived")


@dataclass(frozen=True)
class FmuView:
    """One check. ended: the word for how it ended, if it did not pass."""

    record: CheckRecord
    name: str
    version: str
    anchor: str
    ended: str

    @property
    def importers(self) -> dict[str, dict[str, CheckRow]]:
        """What other people's importers made of it."""
        return by_importer(self.record.fmu.rows) if self.record.fmu else {}

    @property
    def rows(self) -> list[CheckRow]:
        """All other checks."""
        return [row for row in self.record.fmu.rows if not row.name.startswith(IMPORTER)] if self.record.fmu else []


def build(report: Report) -> Section | None:
    """The section, or None where no FMU was checked."""
    records = [record for record in report.stored.checks if record.kind == KIND]
    return of(records) if records else None


def of(records: Sequence[CheckRecord]) -> Section:
    """The section of these checks of FMUs; of anybody's, which are of no scene, it says how they were made."""
    views = [_view(record, place) for place, record in enumerate(records)]
    sentence = _sentence(views)
    ours = any(record.scene for record in records)
    # Of several FMUs each claim stands once: in their tables it would be most of the page.
    rows = [row for record in records if record.fmu is not None for row in record.fmu.rows]
    claims = list(dict.fromkeys((row.name, row.claim) for row in rows)) if len(views) > 1 else []
    statuses = (*STATUSES, *(status for status in RARE if any(row.status == status for row in rows)))
    values = {"views": views, "statuses": statuses, "sentence": sentence, "ours": ours, "claims": claims, "origin": records[0].provenance}
    return Section("fmus", "FMUs under the check", "checks.html#fmus", values, said=sentence)


def _view(record: CheckRecord, place: int) -> FmuView:
    ended = "" if record.passed else "failed" if record.outcome == "answered" else record.outcome.replace("_", " ")
    name, _, version = record.name.partition(", FMI ")
    return FmuView(record, record.scene or name, record.fmu.version if record.fmu else version, f"fmu-{place + 1}", ended)


def _sentence(views: list[FmuView]) -> str:
    scenes = {view.record.scene for view in views} - {None}
    of_scenes = f" of {count(len(scenes), 'scene')}" if scenes else ""
    versions = listing(sorted({view.version for view in views if view.version}))
    looked = [view.record.fmu for view in views if view.record.fmu is not None]
    numbers = {status: sum(fmu.count(status) for fmu in looked) for status in (*STATUSES, *RARE)}
    counts = ", ".join(f"{number} {status}" for status, number in numbers.items() if number or status in STATUSES)
    bad = sum(not view.record.passed for view in views)
    told = f"{bad} of them {'does' if bad == 1 else 'do'} not pass" if bad else "every one passes"
    cost = sum(view.record.cpu_seconds for view in views)
    return f"{count(len(views), 'FMU')}{of_scenes} in FMI {versions}: {told}. Checks: {counts}; {cost:.0f} CPU seconds."
