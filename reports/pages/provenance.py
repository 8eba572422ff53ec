"""Where every number comes from: commits, machine, versions, command, keys; and whether all runs come from the same place."""

from __future__ import annotations

from reports.pages.section import Report, Section
from reports.records.record import ProvenanceRecord
from reports.wording import count

_SAME = ("touchstone", "commit", "python", "platform", "cpu", "compiler")


def build(report: Report) -> Section | None:
    """The section, or None where nothing is stored that has an origin."""
    stored = report.stored
    first = stored.campaign.provenance if stored.campaign else (stored.runs[0].provenance if stored.runs else None)
    if first is None:
        return None
    runs = [(run, report.link(run), differences(first, run.provenance)) for run in stored.runs]
    others = sum(bool(differs) for _, _, differs in runs)
    said = f"Commit, machine, versions and key of each run; {others or 'none'} of {count(len(runs), 'run')} come from elsewhere than the campaign."
    return Section(
        "provenance", "Provenance", "campaign.html#provenance", {"first": first, "runs": runs, "campaign": stored.campaign}, said=said
    )


def differences(first: ProvenanceRecord, other: ProvenanceRecord) -> list[str]:
    """What a run's origin has other than the campaign's, in words."""
    told = [f"{name} {getattr(other, name)}" for name in _SAME if getattr(first, name) != getattr(other, name)]
    names = sorted(set(first.packages) | set(other.packages))
    told += [f"{name} {other.packages.get(name, 'absent')}" for name in names if first.packages.get(name) != other.packages.get(name)]
    return told
