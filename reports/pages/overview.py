"""What a reader sees first: three findings, speed against error, every scene by every pipeline, and a film strip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from reports.judged import judged_metric
from reports.pages.filmstrip import Strip, strip
from reports.pages.front import draw_front
from reports.pages.pareto import cpu
from reports.pages.section import Report, Section
from reports.paper import SCENE as PAPER_SCENE
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import HOLD, CampaignRecord, RunRecord, StageRecord
from reports.wording import VERDICTS, capital, cost, count, error, number, seconds

# Families of the methods that end a run: the paper's three, and ours. Style of their marks, and words.
_FAMILIES = {
    "relaxed": ("c1", "relaxed contact"),
    "gradient": ("c3", "gradient descent"),
    "exact": ("c0", "exact contact"),
    "ours": ("c2", "ours"),
}
_OF_PAPER = {"relaxed_lcp": "relaxed", "softplus_dc": "relaxed", "softplus_gd": "gradient", "relu_gd": "gradient", "strict_lcp": "exact"}
# Below this an error is one of rounding, and below this a clock's tick: drawn at the edge, so that they do not squeeze the rest.
_SMALLEST, _TICK = 1e-12, 1e-3
# A pipeline is recommended by its medians only where it holds on so many scenes.
_ENOUGH = 3
_NOT_ASKED = ("not applicable", "consistent")


@dataclass(frozen=True)
class Place:
    """A run as the matrix shows it; ratio: its cost over that of the cheapest run on its scene that holds, None where it does not hold or costs nothing."""

    run: RunRecord
    link: str
    ratio: float | None
    words: str


@dataclass(frozen=True)
class Standing:
    """A pipeline over the scenes it applies to: on how many its plan holds, and medians over those [of the best cost, CPU s]."""

    pipeline: str
    holds: int
    able: int
    ratio: float | None
    cpu: float | None

    @property
    def rank(self) -> tuple[float, float, float]:
        """The better the smaller: scenes on which it holds, then cost, then time."""
        return -self.holds, self.ratio or float("inf"), self.cpu or float("inf")


def build(report: Report) -> Section | None:
    """The first section of report.html; None of a folder without runs."""
    runs = report.stored.runs
    if not runs:
        return None
    places = _places(report)
    pipelines = list(dict.fromkeys(run.pipeline for run in runs))
    standings = _standings(pipelines, list(places.values()))
    return Section(
        "overview",
        "Overview",
        "first_screen.html",
        {
            "findings": [said for said in (_relaxed(report), _exact(runs), _first(standings)) if said],
            "plot": _speed(report),
            "keys": _keys(),
            "scenes": [(scene, report.scene_link(scene)) for scene in report.scenes],
            "pipelines": pipelines,
            "places": places,
            "strip": _strip(report),
            "about": _about(report.stored.campaign, runs),
            "verdicts": VERDICTS,
        },
    )


def last_of(run: RunRecord) -> StageRecord | None:
    """The stage that a run is judged by."""
    return run.stages[-1] if run.stages else None


def _cpu(run: RunRecord) -> float:
    """CPU seconds of solving: of all stages of a run, wherever they ran."""
    return sum(stage.seconds.stage_cpu for stage in run.stages)


def _places(report: Report) -> dict[tuple[str, str], Place]:
    """(pipeline, scene) -> what the matrix shows."""
    found = {}
    for scene in report.scenes:
        runs = [run for run in report.stored.runs if run.scene.name == scene.name]
        prices = [price for run in runs if run.verdict in HOLD and (price := _price(run)) is not None]
        for run in runs:
            price = _price(run)
            ratio = price / min(prices) if run.verdict in HOLD and price is not None and min(prices, default=0.0) > 0.0 else None
            found[run.pipeline, scene.name] = Place(run, report.link(run), ratio, _words(run, ratio))
    return found


def _price(run: RunRecord) -> float | None:
    last = last_of(run)
    return last.cost if last is not None else None


def _words(run: RunRecord, ratio: float | None) -> str:
    last = last_of(run)
    said = f"{run.pipeline} on {run.scene.name}: {run.verdict}"
    if last is not None and last.cost is not None:
        said += f", cost {cost(last.cost)}" + (f", {number(ratio, 3)} times the cheapest that holds" if ratio is not None else "")
    why = (last.why if last is not None else "") or run.message
    return f"{said}. {capital(why)}" if why and run.verdict not in HOLD else f"{said}."


def _standings(pipelines: Sequence[str], places: Sequence[Place]) -> list[Standing]:
    """The best first; pipelines that apply nowhere are left out."""
    found = []
    for name in pipelines:
        mine = [place for place in places if place.run.pipeline == name and place.run.verdict not in _NOT_ASKED]
        holding = [place for place in mine if place.run.verdict in HOLD]
        ratios = [place.ratio for place in holding if place.ratio is not None]
        if mine:
            cpu = median(_cpu(place.run) for place in holding) if holding else None
            found.append(Standing(name, len(holding), len(mine), median(ratios) if ratios else None, cpu))
    return sorted(found, key=lambda standing: standing.rank)


def _relaxed(report: Report) -> str:
    """Whether relaxed plans hold."""
    plans = [row for row in report.rows if row.stage.kind == "indirect" and row.stage.verdict not in ("no plan", *_NOT_ASKED)]
    if not plans:
        return ""
    failing = [row for row in plans if row.stage.verdict == "violates"]
    misses = [value for row in failing if (value := row.metric("replay_terminal_error")) is not None]
    miss = f"; replayed, they miss the goal by {error(median(misses))} in the median (position and velocity together)" if misses else ""
    return f"Relaxed plans do not hold: {len(failing)} of {len(plans)} violate{miss}."


def _exact(runs: Sequence[RunRecord]) -> str:
    """Whether exact ones do."""
    ending = [run for run in runs if run.must_hold]
    asked = [run for run in ending if run.verdict not in _NOT_ASKED]
    if not asked:
        return ""
    holding, without = [run for run in asked if run.verdict in HOLD], sum(run.verdict == "no plan" for run in asked)
    followed = sum(run.verdict == "holds with feedback" for run in holding)
    beside = [f"{followed} of them with feedback" if followed else "", f"{without} found no plan" if without else ""]
    aside = len(ending) - len(asked)
    told = "; ".join(part for part in beside if part)
    return f"{len(holding)} of {count(len(asked), 'run')} that end with exact contact hold{f' ({told})' if told else ''}." + (
        f" {aside} more do not apply to their scene." if aside else ""
    )


def _first(standings: Sequence[Standing]) -> str:
    """Which method to try first."""
    good = [standing for standing in standings if standing.holds]
    if not good:
        return "No pipeline found a plan that holds."
    best = good[0]
    fast = min((standing for standing in good if standing.holds >= min(_ENOUGH, best.holds)), key=lambda standing: standing.cpu or 0.0)
    said = f"Try first {_standing(best)}."
    return said if fast is best else f"{said} The fastest is {_standing(fast)}."


def _standing(standing: Standing) -> str:
    price = f"{number(standing.ratio, 3)} times the best cost" if standing.ratio is not None else ""
    time = f", {seconds(standing.cpu)} CPU s" if standing.cpu is not None else ""
    medians = f" ({price}{time}, medians)" if price or time else ""
    return f"{standing.pipeline}, which holds on {standing.holds} of its {count(standing.able, 'scene')}{medians}"


def _about(campaign: CampaignRecord | None, runs: Sequence[RunRecord]) -> dict[str, str]:
    provenance = campaign.provenance if campaign and campaign.provenance else runs[0].provenance
    scenes, pipelines = len({run.scene.name for run in runs}), len({run.pipeline for run in runs})
    return {
        "what": f"{count(scenes, 'scene')} by {count(pipelines, 'pipeline')}, {count(len(runs), 'run')}",
        "when": (campaign.started if campaign else provenance.started)[:16].replace("T", " "),
        "where": f"{provenance.cpu}, {count(provenance.cores, 'core')}",
        "time": f"{seconds(sum(run.cpu_seconds for run in runs))} CPU s",
        "command": campaign.command if campaign else provenance.command,
    }


def _keys() -> list[Key]:
    families = [Key(style, words, "circle") for style, words in _FAMILIES.values()]
    return [*families, Key("c2 full", "filled: holds", "circle"), Key("front", "front")]


def _speed(report: Report) -> Plot | None:
    """CPU seconds against replay error: a mark for each plan, and the names of the pipelines whose medians over their scenes no other beats."""
    points = []
    for row in report.rows:
        metric = judged_metric(row.stage, "replay_error")
        if metric is not None and metric.value is not None:
            own = (row.stage.replay.error_estimate if row.stage.replay else None) or 0.0
            points.append((max(cpu(row), _TICK), max(metric.value, own, _SMALLEST), row))
    if not points:
        return None
    plot = Plot(
        "Speed against error",
        Axis.fitted("CPU time, with the stages before", "s", [x for x, *_ in points], log=True, margin=0.05),
        Axis.fitted("replay error", "m or rad", [y for _, y, *_ in points], log=True, margin=0.05),
        width=560,
        height=400,
    )
    for x, y, row in points:
        style = _FAMILIES[_OF_PAPER.get(row.stage.method, "ours")][0] + (" full" if row.holds else "")
        tip = f"{row.label} on {row.run.scene.name}: {row.stage.verdict}; {seconds(x)} CPU s, replay error {error(y)}"
        plot.point(x, y, style, "circle", tip, row.link, radius=3.5, keeps_free=False)
    medians = []
    for name in dict.fromkeys(row.run.pipeline for _, _, row in points):
        mine = [(x, y) for x, y, row in points if row.run.pipeline == name and row.holds and row.stage is row.run.stages[-1]]
        if len(mine) >= min(_ENOUGH, len(report.scenes)):
            medians.append((median(x for x, _ in mine), median(y for _, y in mine), name))
    lasting = [point for point in medians if not any(other[0] < point[0] and other[1] < point[1] for other in medians)]
    lasting.sort()
    draw_front(plot, [point[:2] for point in lasting])
    plot.name_points(lasting)
    wrong = sum(row.stage.verdict == "violates" for _, _, row in points)
    plot.words = (
        f"Left is fast, below is near to its replay. {wrong} of {count(len(points), 'plan')} violate (hollow). "
        "The line joins the medians of pipelines, where they hold, that no other beats in both."
    )
    return plot


def _strip(report: Report) -> tuple[Strip, str, RunRecord] | None:
    """Of the paper's scene, else of the first: its cheapest plan that holds."""
    for name in dict.fromkeys((PAPER_SCENE, *(scene.name for scene in report.scenes))):
        runs = [
            run
            for run in report.stored.runs
            if run.scene.name == name and run.verdict in HOLD and _price(run) is not None and run.must_hold
        ]
        for run in sorted(runs, key=lambda run: _price(run) or 0.0):
            last = last_of(run)
            drawn = strip(run.scene, report.plan(run, last)) if last is not None else None
            if drawn is not None:
                return drawn, report.link(run), run
    return None
