"""First screen of a report: findings, speed against error, matrix, film strip; failures; index.

Failures are grouped by cause, with causes of the campaign's failure and unreadable files.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

from models.results.run import CampaignRecord, RunRecord
from models.results.verdict import HOLD
from reports.findings import ENOUGH, NOT_ASKED, cost_ratio, least_costs, three_findings
from reports.judged import Cause, by_cause, cause_of, deciding
from reports.load import Unreadable
from reports.pages.pareto import TICK, cpu, draw_front, keys, style_of, told_error
from reports.pages.player import Film, strip
from reports.pages.run import not_applicable
from reports.pages.section import Report, Section
from reports.paper import SCENE as PAPER_SCENE
from reports.plots import Axis, Plot
from reports.rows import Row
from reports.rule import RESULTS, RULE, failed_keys, failures
from reports.wording import (
    VERDICTS,
    capital,
    cost,
    count,
    error,
    listing,
    measured,
    number,
    seconds,
    unit,
)


class Place(NamedTuple):
    """A cell of the matrix; ratio: cost over the scene's cheapest, None if it does not hold."""

    run: RunRecord
    link: str
    ratio: float | None
    words: str


def build(report: Report) -> Section:
    """Return the first section of report.html."""
    runs = report.stored.runs
    values = {
        "notices": notices(report),
        "findings": three_findings(runs),
        "plot": _speed(report),
        "keys": keys("front"),
        "scenes": [(scene, report.scene_link(scene)) for scene in report.scenes],
        "pipelines": list(dict.fromkeys(run.pipeline for run in runs)),
        "places": _places(report),
        "strip": _strip(report),
        "about": _about(report.stored.campaign, runs),
        "verdicts": VERDICTS,
    }
    return Section("overview", "Overview", "report.html#overview", values)


def _places(report: Report) -> dict[tuple[str, str], Place]:
    least, cells = least_costs(report.stored.runs), {}
    for run in report.stored.runs:
        ratio = cost_ratio(run, least)
        cells[run.pipeline, run.scene.name] = Place(
            run, report.link(run), ratio, _words(run, ratio)
        )
    return cells


def _words(run: RunRecord, ratio: float | None) -> str:
    price, cause = run.cost, cause_of(run)
    text = f"{run.pipeline} on {run.scene.name}: {run.verdict}"
    if ratio is not None:
        return f"{text}, cost {cost(price)}" + (
            f", {number(ratio, 3)} times the cheapest" if ratio > 1 else ", the cheapest"
        )
    if cause is None:
        reason = not_applicable(run)
        return f"{text}. {reason}" if reason else text
    metric = deciding(run.stages[-1]) if run.stages else None
    if metric is None or metric.value is None:
        return f"{text}. {cause.sentence}"
    return f"{text}. {cause.sentence} ({number(metric.value, 3)} {unit(metric.unit)}, limit {number(metric.limit, 3)})"


def _about(campaign: CampaignRecord | None, runs: Sequence[RunRecord]) -> dict[str, str] | None:
    if campaign is None and not runs:
        return None
    provenance = campaign.provenance if campaign else runs[0].provenance
    scenes, pipelines = len({run.scene.name for run in runs}), len({run.pipeline for run in runs})
    return {
        "what": f"{count(scenes, 'scene')} by {count(pipelines, 'pipeline')}, {count(len(runs), 'run')}",
        "when": (campaign.started if campaign else provenance.started)[:16].replace("T", " "),
        "where": f"{provenance.cpu}, {count(provenance.cores, 'core')}",
        "time": f"{seconds(sum(run.cpu_seconds for run in runs))} CPU s",
        "command": campaign.command if campaign else provenance.command,
    }


def _ends_leg(row: Row) -> bool:
    later = row.run.stages[row.stage.index + 1 :]
    return not later or later[0].method != row.stage.method


def _speed(report: Report) -> Plot | None:
    """Return the plot of CPU seconds against replay error, naming the unbeaten pipelines."""
    points = []
    for row in report.rows:
        missed = told_error(row)
        if row.stage.verdict not in NOT_ASKED and _ends_leg(row) and missed is not None:
            points.append((max(cpu(row), TICK), missed, row))
    if not points:
        return None
    across = Axis.fitted(
        "CPU time, with the stages before", "s", [x for x, *_ in points], log=True, margin=0.05
    )
    up = Axis.fitted("replay error", "m or rad", [y for _, y, *_ in points], log=True, margin=0.05)
    plot = Plot("Speed against error", across, up, width=560, height=400)
    for x, y, row in points:
        tip = f"{row.label} on {row.run.scene.name}: {row.stage.verdict}; {seconds(x)} CPU s, error {error(y)}"
        plot.point(x, y, style_of(row), "circle", tip, row.link, radius=3.5, keeps_free=False)
    medians = []
    for name in dict.fromkeys(row.run.pipeline for _, _, row in points):
        mine = [
            (x, y)
            for x, y, row in points
            if row.run.pipeline == name and row.holds and row.stage is row.run.stages[-1]
        ]
        if len(mine) >= min(ENOUGH, len(report.scenes)):
            medians.append((median(x for x, _ in mine), median(y for _, y in mine), name))
    lasting = [
        point
        for point in medians
        if not any(other[0] < point[0] and other[1] < point[1] for other in medians)
    ]
    lasting.sort()
    draw_front(plot, [point[:2] for point in lasting])
    plot.name_points(lasting)
    wrong = sum(row.stage.verdict == "violates" for _, _, row in points)
    plot.words = f"Left is fast, below is near to its replay; relaxations at their tightest ε. {wrong} of {count(len(points), 'plan')} violate (hollow)."
    if len(lasting) > 1:
        names = listing([name for *_, name in lasting])
        plot.words += f" The line joins {names}: no other pipeline is better in both, by medians over the scenes where it holds."
    return plot


def _strip(report: Report) -> tuple[Film, str, RunRecord] | None:
    """Return the film strip of the cheapest plan that holds, preferably on the paper's scene."""
    for name in dict.fromkeys((PAPER_SCENE, *(scene.name for scene in report.scenes))):
        for run, _ in report.stored.cheapest(name):
            drawn = strip(run.scene, report.plan(run, run.stages[-1]))
            if drawn is not None:
                return drawn, report.link(run), run
    return None


def index(report: Report, others: Sequence[tuple[str, Section]]) -> Section | None:
    """Return the index; others: (file name, first section) of each further page."""
    pages = [
        (
            report.page_link(name, section.anchor if report.single else ""),
            section.title,
            section.said,
        )
        for name, section in others
    ]
    scenes = []
    for scene in report.scenes:
        judged = [
            run
            for run in report.stored.runs
            if run.scene.name == scene.name and run.verdict not in NOT_ASKED
        ]
        best = next(
            (
                f"{run.pipeline}, cost {cost(price)}"
                for run, price in report.stored.cheapest(scene.name)
            ),
            "",
        )
        scenes.append(
            (
                scene,
                report.scene_link(scene),
                sum(run.verdict in HOLD for run in judged),
                len(judged),
                best,
            )
        )
    return (
        Section("index", "More pages", "report.html#index", {"scenes": scenes, "pages": pages})
        if scenes or pages
        else None
    )


# Largest number of sentences or files that are not folded.
_FEW = 12


class FailedRun(NamedTuple):
    """A failing run; by, limit: deciding metric and limit; must: the campaign fails by it."""

    run: RunRecord
    link: str
    by: str
    limit: str
    must: bool


class CauseView(NamedTuple):
    """A cause and its runs by scene: (name, link, common limit, runs)."""

    cause: Cause
    amount: int
    scenes: list[tuple[str, str, str, list[FailedRun]]]


def what_failed(report: Report) -> Section:
    """Return the section of failures."""
    stored = report.stored
    must = failed_keys([*stored.runs, *stored.checks])
    groups = [_cause_view(report, cause, runs, must) for cause, runs in by_cause(stored.runs)]
    values = {
        "groups": groups,
        "total": sum(group.amount for group in groups),
        "asked": bool(stored.runs or stored.checks),
        "whole": not (stored.missing or stored.unreadable),
        "broken": failures(stored.runs, stored.checks),
        "few": _FEW,
        "rule": RULE,
        "results": RESULTS,
        "unreadable": _by_sentence(stored.unreadable),
        "missing": stored.missing,
        "campaign": stored.campaign,
    }
    return Section("failures", "What failed, by cause", "report.html#failures", values)


def _cause_view(
    report: Report, cause: Cause, runs: list[RunRecord], must: frozenset[str]
) -> CauseView:
    scenes: dict[str, list[FailedRun]] = {}
    links = {scene.name: report.scene_link(scene) for scene in report.scenes}
    for run in runs:
        scenes.setdefault(run.scene.name, []).append(
            FailedRun(run, report.link(run), *_decided_by(run), run.key in must)
        )
    return CauseView(
        cause,
        len(runs),
        [(name, links[name], _shared(mine), mine) for name, mine in scenes.items()],
    )


def _shared(runs: list[FailedRun]) -> str:
    limits = {item.limit for item in runs}
    return limits.pop() if len(limits) == 1 else ""


def _decided_by(run: RunRecord) -> tuple[str, str]:
    """Return the deciding value and its limit, as `0.43 m` and `0.050 m`."""
    metric = (
        deciding(run.stages[-1])
        if run.stages and run.verdict in ("violates", "undecided")
        else None
    )
    if metric is None or metric.value is None or metric.limit is None:
        return "", ""
    return measured(metric.value, metric.unit), measured(metric.limit, metric.unit)


def _by_sentence(unreadable: tuple[Unreadable, ...]) -> list[tuple[str, list[str]]]:
    by_reason: dict[str, list[str]] = {}
    for item in unreadable:
        by_reason.setdefault(item.sentence, []).append(item.path)
    return list(by_reason.items())


def notices(report: Report) -> list[str]:
    """Return notices about missing, unreadable, omitted or unstable parts."""
    stored, sentences = report.stored, []
    if stored.campaign is None:
        sentences.append(
            "The campaign's own record is missing or unreadable: this page shows every run it finds, in the order of their names."
        )
    if not stored.runs and not stored.checks:
        sentences.append("No run is stored here yet; there is nothing to judge.")
    if stored.missing:
        has = "has" if len(stored.missing) == 1 else "have"
        sentences.append(
            f"{count(len(stored.missing), 'run')} of the campaign {has} no stored record yet; the same command runs them."
        )
    if stored.unreadable:
        sentences.append(
            f"{count(len(stored.unreadable), 'file')} could not be read: {_first_reason(stored.unreadable)}."
        )
    if stored.foreign:
        belongs = (
            "belongs to another campaign and is"
            if stored.foreign == 1
            else "belong to another campaign and are"
        )
        sentences.append(
            f"{count(stored.foreign, 'stored run')} in this folder {belongs} left out."
        )
    if stored.campaign is not None:
        if stored.campaign.quick:
            sentences.append("This was a quick campaign; what it left out is listed below.")
        sentences += [
            capital(item.sentence) for item in stored.campaign.time_steps if not item.is_stable
        ]
    return sentences


def _first_reason(unreadable: tuple[Unreadable, ...]) -> str:
    (why, files), *others = sorted(_by_sentence(unreadable), key=lambda item: -len(item[1]))
    return (f"of {len(files)} of them " if others else "") + why.rstrip(".").replace("; ", ", ")
