"""What a reader sees first: three findings, speed against error, every scene by every pipeline, a film strip; what failed; and what leads to the other pages.

What failed is grouped by cause: each cause once, with its advice and its runs; with it what makes
the campaign fail, and what could not be read.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

from reports.findings import ENOUGH, NOT_ASKED, cost_ratio, least_costs, three_findings
from reports.judged import Cause, by_cause, cause_of, deciding
from reports.pages.pareto import TICK, cpu, draw_front, keys, style_of, told_error
from reports.pages.player import Film, strip
from reports.pages.run import not_applicable
from reports.pages.section import Report, Section
from reports.paper import SCENE as PAPER_SCENE
from reports.plots import Axis, Plot
from reports.records.load import Unreadable
from reports.records.record import HOLD, CampaignRecord, RunRecord
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
    """A run as the matrix shows it.

    ratio: its cost over that of the cheapest run on its scene that holds, None where it does not
    hold or costs nothing.
    """

    run: RunRecord
    link: str
    ratio: float | None
    words: str


def build(report: Report) -> Section:
    """The first section of report.html; of a folder without runs it says that."""
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
    """(pipeline, scene) -> what the matrix shows."""
    least, found = least_costs(report.stored.runs), {}
    for run in report.stored.runs:
        ratio = cost_ratio(run, least)
        found[run.pipeline, run.scene.name] = Place(
            run, report.link(run), ratio, _words(run, ratio)
        )
    return found


def _words(run: RunRecord, ratio: float | None) -> str:
    """What a cell says on hover: the pipeline, the scene, the verdict and why."""
    price, cause = run.cost, cause_of(run)
    said = f"{run.pipeline} on {run.scene.name}: {run.verdict}"
    if ratio is not None:
        return f"{said}, cost {cost(price)}" + (
            f", {number(ratio, 3)} times the cheapest" if ratio > 1 else ", the cheapest"
        )
    if cause is None:
        reason = not_applicable(run)
        return f"{said}. {reason}" if reason else said
    metric = deciding(run.stages[-1]) if run.stages else None
    if metric is None or metric.value is None:
        return f"{said}. {cause.sentence}"
    return f"{said}. {cause.sentence} ({number(metric.value, 3)} {unit(metric.unit)}, limit {number(metric.limit, 3)})"


def _about(campaign: CampaignRecord | None, runs: Sequence[RunRecord]) -> dict[str, str] | None:
    """What was run, when, where, in how much time, and the command that repeats it.

    None where nothing is stored that says so.
    """
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
    """Whether it is the last stage of its method in the run: what the method came to, at its tightest eps."""
    later = row.run.stages[row.stage.index + 1 :]
    return not later or later[0].method != row.stage.method


def _speed(report: Report) -> Plot | None:
    """CPU seconds against replay error: a mark for what each method came to, and the names of the pipelines whose medians over their scenes no other beats."""
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
    """Of the paper's scene, else of the first that has one: its cheapest plan that holds."""
    for name in dict.fromkeys((PAPER_SCENE, *(scene.name for scene in report.scenes))):
        for run, _ in report.stored.cheapest(name):
            drawn = strip(run.scene, report.plan(run, run.stages[-1]))
            if drawn is not None:
                return drawn, report.link(run), run
    return None


def index(report: Report, others: Sequence[tuple[str, Section]]) -> Section | None:
    """The last section of report.html. others: (file name, first section) of each page that is neither a scene's nor a run's."""
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
        asked = [
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
                sum(run.verdict in HOLD for run in asked),
                len(asked),
                best,
            )
        )
    return (
        Section("index", "More pages", "report.html#index", {"scenes": scenes, "pages": pages})
        if scenes or pages
        else None
    )


# So many sentences or files are told one below the other; more are folded.
_FEW = 12


class FailedRun(NamedTuple):
    """A run that fails by a cause. by, limit: the value of the metric that decided it, and its limit, or nothing; must: the campaign fails by it."""

    run: RunRecord
    link: str
    by: str
    limit: str
    must: bool


class CauseView(NamedTuple):
    """A cause and its runs, by scene: (name, link, the limit that they share, or nothing, runs)."""

    cause: Cause
    amount: int
    scenes: list[tuple[str, str, str, list[FailedRun]]]


def what_failed(report: Report) -> Section:
    """The section; it says so where nothing failed."""
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
    """The limit of all of them; empty where they have several."""
    limits = {item.limit for item in runs}
    return limits.pop() if len(limits) == 1 else ""


def _decided_by(run: RunRecord) -> tuple[str, str]:
    """`0.43 m` and `0.050 m`: what decided, and its limit."""
    metric = (
        deciding(run.stages[-1])
        if run.stages and run.verdict in ("violates", "undecided")
        else None
    )
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
        said.append(
            "The campaign's own record is missing or unreadable: this page shows every run it finds, in the order of their names."
        )
    if not stored.runs and not stored.checks:
        said.append("No run is stored here yet; there is nothing to judge.")
    if stored.missing:
        has = "has" if len(stored.missing) == 1 else "have"
        said.append(
            f"{count(len(stored.missing), 'run')} of the campaign {has} no stored record yet; the same command runs them."
        )
    if stored.unreadable:
        said.append(
            f"{count(len(stored.unreadable), 'file')} could not be read: {_first_reason(stored.unreadable)}."
        )
    if stored.foreign:
        belongs = (
            "belongs to another campaign and is"
            if stored.foreign == 1
            else "belong to another campaign and are"
        )
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
