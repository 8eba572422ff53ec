"""What failed, grouped by cause: each cause once, with its advice and its runs; what makes the campaign fail; and what could not be read."""

from __future__ import annotations

from dataclasses import dataclass

from reports.causes import Cause, by_cause, deciding
from reports.pages.section import Report, Section
from reports.records.load import Unreadable
from reports.records.record import RunRecord
from reports.rule import failed_keys, failures
from reports.rule_text import RESULTS, RULE
from reports.wording import capital, count, measured

# So many sentences or files are told one below the other; more are folded.
_FEW = 12


@dataclass(frozen=True)
class FailedRun:
    """A run that fails by a cause. by, limit: the value of the metric that decided it, and its limit, or nothing; must: the campaign fails by it."""

    run: RunRecord
    link: str
    by: str
    limit: str
    must: bool


@dataclass(frozen=True)
class CauseView:
    """A cause and its runs, by scene: (name, link, the limit that they share, or nothing, runs)."""

    cause: Cause
    amount: int
    scenes: list[tuple[str, str, str, list[FailedRun]]]


def build(report: Report) -> Section:
    """The section; it says so where nothing failed."""
    stored = report.stored
    broken = failures(stored.runs, stored.checks)
    must = failed_keys([*stored.runs, *stored.checks])
    groups = [_view(report, cause, runs, must) for cause, runs in by_cause(stored.runs)]
    total = sum(group.amount for group in groups)
    return Section(
        "failures",
        "What failed, by cause",
        "report.html#failures",
        {
            "groups": groups,
            "total": total,
            "asked": bool(stored.runs or stored.checks),
            "whole": not (stored.missing or stored.unreadable),
            "broken": broken,
            "few": _FEW,
            "rule": RULE,
            "results": RESULTS,
            "unreadable": _by_sentence(stored.unreadable),
            "missing": stored.missing,
            "campaign": stored.campaign,
        },
    )


def _view(report: Report, cause: Cause, runs: list[RunRecord], must: frozenset[str]) -> CauseView:
    scenes: dict[str, list[FailedRun]] = {}
    links = {scene.name: report.scene_link(scene) for scene in report.scenes}
    for run in runs:
        scenes.setdefault(run.scene.name, []).append(FailedRun(run, report.link(run), *_by(run), run.key in must))
    return CauseView(cause, len(runs), [(name, links[name], _shared(mine), mine) for name, mine in scenes.items()])


def _shared(runs: list[FailedRun]) -> str:
    """The limit of all of them; empty where they have several."""
    limits = {item.limit for item in runs}
    return limits.pop() if len(limits) == 1 else ""


def _by(run: RunRecord) -> tuple[str, str]:
    """`0.43 m` and `0.050 m`: what decided, and its limit."""
    metric = deciding(run.stages[-1]) if run.stages and run.verdict in ("violates", "undecided") else None
    if metric is None or metric.value is None or metric.limit is None:
        return "", ""
    return measured(metric.value, metric.unit), measured(metric.limit, metric.unit)


def _by_sentence(unreadable: tuple[Unreadable, ...]) -> list[tuple[str, list[str]]]:
    """(why, the files of which it is true)."""
    found: dict[str, list[str]] = {}
    for item in unreadable:
        found.setdefault(item.sentence, []).append(item.path)
    return list(found.items())


def notices(report: Report) -> list[str]:
    """What a reader must know before anything else: what is missing, cannot be read, was left out, or was known to be unstable."""
    stored, said = report.stored, []
    if stored.campaign is None:
        said.append("The campaign's own record is missing or unreadable: this page shows every run it finds, in the order of their names.")
    if not stored.runs and not stored.checks:
        said.append("No run is stored here yet; there is nothing to judge.")
    if stored.missing:
        has = "has" if len(stored.missing) == 1 else "have"
        said.append(f"{count(len(stored.missing), 'run')} of the campaign {has} no stored record yet; the same command runs them.")
    if stored.unreadable:
        said.append(f"{count(len(stored.unreadable), 'file')} could not be read: {_first_reason(stored.unreadable)}.")
    if stored.foreign:
        belongs = "belongs to another campaign and is" if stored.foreign == 1 else "belong to another campaign and are"
        said.append(f"{count(stored.foreign, 'stored run')} in this folder {belongs} left out.")
    if stored.campaign is not None:
        if stored.campaign.quick:
            said.append("This was a quick campaign; what it left out is listed below.")
        said += [capital(item.warning) for item in stored.campaign.time_steps if item.warning]
    return said


def _first_reason(unreadable: tuple[Unreadable, ...]) -> str:
    """Why most of them could not."""
    (why, files), *others = sorted(_by_sentence(unreadable), key=lambda item: -len(item[1]))
    return (f"of {len(files)} of them " if others else "") + why.rstrip(".").replace("; ", ", ")
