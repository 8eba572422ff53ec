"""Time spent by phases, and provenance of a campaign."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

from models.results.run import ProvenanceRecord, RunRecord
from reports.pages.section import Report, Section
from reports.wording import count, listing, seconds, spaced

_SLOWEST = 10
# (words, group) by phase; other phases are shown by name in the last group.
PHASES = {
    "start": ("interpreter", "starting"),
    "imports": ("imports", "starting"),
    "scene": ("reading the scene", "starting"),
    "shared": ("sharing stages with other runs", "other"),
    "compile": ("compiling the scene", "compiling"),
    "opening": ("opening methods", "starting"),
    "build": ("building models", "modelling"),
    "translate": ("translating models", "modelling"),
    "evaluate": ("functions and derivatives", "evaluating"),
    "linear_algebra": ("linear algebra of solvers", "linear algebra"),
    "solve_rest": ("solving otherwise", "other"),
    "certificate": ("certificates", "judging"),
    "survey": ("trying plans in perturbed worlds", "judging"),
    "fmu_build": ("building the FMU", "compiling"),
    "replay": ("replaying", "judging"),
    "writing": ("writing files", "other"),
    "record": ("the record", "other"),
}
_GROUPS: tuple[str, ...] = (
    "starting",
    "compiling",
    "modelling",
    "evaluating",
    "linear algebra",
    "judging",
    "other",
)
# Width of the longest bar.
_WIDTH = 200.0
# Smallest share that the sentence mentions.
_MENTIONED = 0.1


class Slow(NamedTuple):
    """One run.

    - groups: wall seconds by group.
    - phases: (words, seconds), the longest first.
    - bar: (x, width, style, words) of its pieces, relative to the slowest run.
    """

    run: RunRecord
    link: str
    groups: tuple[float, ...]
    phases: tuple[tuple[str, float], ...]
    bar: tuple[tuple[float, float, str, str], ...]


def time_spent(report: Report) -> Section | None:
    """Return the section, None without profiles."""
    profiled = sorted(
        (run for run in report.stored.runs if run.profile),
        key=lambda run: (-run.wall_seconds, run.key),
    )
    if not profiled:
        return None
    longest = profiled[0].wall_seconds or 1.0
    slowest = [_slow(run, report.link(run), longest) for run in profiled[:_SLOWEST]]
    values = {
        "slowest": slowest,
        "groups": _GROUPS,
        "styles": {group: _style(group) for group in _GROUPS},
        "sentence": _sentence(profiled),
        "without": len(report.stored.runs) - len(profiled),
        "width": _WIDTH,
    }
    said = values["sentence"] or "The slowest runs, each by what its seconds were spent on."
    return Section("time-spent", "Where time goes", "campaign.html#time_spent", values, said=said)


def _style(group: str) -> str:
    return f"c{_GROUPS.index(group) % 6}" if group != _GROUPS[-1] else "rest"


def _known(phase: str) -> tuple[str, str]:
    return PHASES.get(phase, (spaced(phase), _GROUPS[-1]))


def _slow(run: RunRecord, link: str, longest: float) -> Slow:
    groups, phases = dict.fromkeys(_GROUPS, 0.0), []
    for phase, spent in run.profile.items():
        words, group = _known(phase)
        groups[group] += spent
        phases.append((words, spent))
    bar, x = [], 0.0
    for group, spent in groups.items():
        width = max(0.0, _WIDTH * spent / longest)
        bar.append((round(x, 2), round(width, 2), _style(group), f"{group}: {seconds(spent)} s"))
        x += width
    return Slow(
        run,
        link,
        tuple(groups.values()),
        tuple(sorted(phases, key=lambda item: -item[1])),
        tuple(bar),
    )


def _sentence(runs: list[RunRecord]) -> str:
    spent: defaultdict[str, float] = defaultdict(float)
    for run in runs:
        for phase, took in run.profile.items():
            spent[_known(phase)[0]] += took
    whole = sum(spent.values())
    if whole <= 0.0:
        return ""
    longest = sorted(spent.items(), key=lambda item: -item[1])
    phrases = [
        f"{name} ({100 * took / whole:.0f} %)"
        for name, took in longest
        if took >= _MENTIONED * whole
    ]
    return (
        f"Of the {seconds(whole)} s of {count(len(runs), 'run')}, most went to {listing(phrases)}."
        if phrases
        else ""
    )


_SAME = ("touchstone", "commit", "python", "platform", "cpu", "compiler")


def provenance(report: Report) -> Section | None:
    """Return the section, None without provenance."""
    stored = report.stored
    first = (
        stored.campaign.provenance
        if stored.campaign
        else (stored.runs[0].provenance if stored.runs else None)
    )
    if first is None:
        return None
    runs = [(run, report.link(run), differences(first, run.provenance)) for run in stored.runs]
    others = sum(bool(differs) for _, _, differs in runs)
    sentence = f"Commit, machine, versions and key of each run; {others or 'none'} of {count(len(runs), 'run')} come from elsewhere than the campaign."
    values = {"first": first, "runs": runs, "campaign": stored.campaign}
    return Section("provenance", "Provenance", "campaign.html#provenance", values, said=sentence)


def differences(first: ProvenanceRecord, other: ProvenanceRecord) -> list[str]:
    """Return the differences of a run's provenance from the campaign's."""
    result = [
        f"{name} {getattr(other, name)}"
        for name in _SAME
        if getattr(first, name) != getattr(other, name)
    ]
    names = sorted(set(first.packages) | set(other.packages))
    result += [
        f"{name} {other.packages.get(name, 'absent')}"
        for name in names
        if first.packages.get(name) != other.packages.get(name)
    ]
    return result
