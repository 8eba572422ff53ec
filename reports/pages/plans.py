"""Foreign plans: the answers to the three questions, instance by instance."""

from __future__ import annotations

from models.results.run import OWN_STEP
from reports.foreign import answers, sentence
from reports.pages.section import Report, Section


def build(report: Report) -> Section | None:
    """Return the section, or None without foreign plans."""
    found = answers(report.stored.runs)
    if not found:
        return None
    rows = [
        (
            one,
            report.link(one.run),
            "" if one.own is None else report.link(one.own),
            one.run.stages[-1].residuals.get(OWN_STEP),
            None if one.own is None else one.own.stages[-1].judged("replay_error"),
            one.run.stages[-1].judged("replay_error"),
        )
        for one in found
    ]
    said = sentence(found)
    return Section("plans", "Foreign plans", "plans.html", {"rows": rows, "said": said}, said=said)
