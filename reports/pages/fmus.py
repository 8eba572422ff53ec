"""Our own FMUs under the check: a row a scene and version of FMI, and every check of each."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.section import Report, Section
from reports.records.check_record import ExaminationRecord, FmuRecord
from reports.wording import count, listing

KIND = "FMU"
STATUSES = ("passed", "failed", "not offered")


@dataclass(frozen=True)
class FmuView:
    """One examination; fmu: None where it ended before there was an answer. ended: the word for how it ended, if it did not pass."""

    record: ExaminationRecord
    fmu: FmuRecord | None
    name: str
    version: str
    anchor: str
    ended: str


def build(report: Report) -> Section | None:
    """The section, or None where no FMU was checked."""
    records = [record for record in report.stored.examinations if record.kind == KIND]
    if not records:
        return None
    views = [_view(record, place) for place, record in enumerate(records)]
    sentence = _sentence(views)
    return Section(
        "fmus", "FMUs under the check", "checks.html#fmus", {"views": views, "statuses": STATUSES, "sentence": sentence}, said=sentence
    )


def _view(record: ExaminationRecord, place: int) -> FmuView:
    ended = "" if record.passed else "failed" if record.outcome == "answered" else record.outcome.replace("_", " ")
    name, _, version = record.name.partition(", FMI ")
    return FmuView(record, record.fmu, record.scene or name, record.fmu.version if record.fmu else version, f"fmu-{place + 1}", ended)


def _sentence(views: list[FmuView]) -> str:
    scenes = len({view.name for view in views})
    versions = listing(sorted({view.version for view in views if view.version}))
    looked = [view.fmu for view in views if view.fmu is not None]
    counts = ", ".join(f"{sum(fmu.count(status) for fmu in looked)} {status}" for status in STATUSES)
    bad = sum(not view.record.passed for view in views)
    told = "every one passes" if not bad else f"{bad} of them {'does' if bad == 1 else 'do'} not pass"
    cost = sum(view.record.cpu_seconds for view in views)
    return f"{count(len(views), 'FMU')} of {count(scenes, 'scene')} in FMI {versions}: {told}. Checks: {counts}; {cost:.0f} CPU seconds."
