"""Least cost of the exact problem within each terminal tolerance, and every row at its own terminal error on the same axes."""

from __future__ import annotations

from typing import NamedTuple

from reports.pages.section import Report, Section
from reports.plots import Axis, Key, Plot, is_wide
from reports.records.record import FrontPointRecord, RunRecord, SceneRecord
from reports.rows import Row
from reports.wording import cost, count, error, percent

# How far left of the smallest tolerance the edge of the plot lies, where plans that reach the goal are drawn.
_EDGE = 0.25
# Relative difference below which a row lies on the front: that of two solves of one problem.
_SAME = 1e-6
_ON_IT = "on it"


class Beside(NamedTuple):
    """A row beside the front: what the plans that end as near to the goal cost at least, as far as is known."""

    row: Row
    missed: float
    price: float
    least: str
    above: str


class Exactness(NamedTuple):
    """The front that one run found. link: of that run."""

    run: RunRecord
    link: str
    points: tuple[FrontPointRecord, ...]
    plot: Plot
    beside: list[Beside]


def build(report: Report, scene: SceneRecord) -> Section | None:
    """The section of one scene, or None where no run on it has a front."""
    runs = [run for run in report.stored.runs if run.scene.name == scene.name]
    views = [view for run in runs if (view := _view(report, run)) is not None]
    if not views:
        return None
    anchor, values = f"tolerance-{report.scenes.index(scene) + 1}", {"scene": scene, "views": views}
    return Section(anchor, "Least cost within a terminal tolerance", "scene.html#tolerance", values)


def windows_text(windows: tuple[tuple[str, int, int], ...]) -> str:
    """The steps at which contacts are closed: left 131–178, 227–274; right 276–306."""
    names = list(dict.fromkeys(name for name, _, _ in windows))
    return "; ".join(f"{name} " + ", ".join(f"{first}–{last}" for other, first, last in windows if other == name) for name in names)


def least_within(points: tuple[FrontPointRecord, ...], missed: float) -> tuple[float | None, float | None]:
    """(cost of the next looser point, of the next tighter one): the least known cost at this terminal error lies between them."""
    priced = [point for point in points if point.cost is not None]
    tight = [point for point in priced if point.tolerance <= missed * (1 + _SAME)]
    loose = [point for point in priced if point.tolerance > missed * (1 + _SAME)]
    return (loose[0].cost if loose else None), (tight[-1].cost if tight else None)


def _view(report: Report, run: RunRecord) -> Exactness | None:
    stage = next((stage for stage in run.stages if any(point.cost is not None for point in stage.front)), None)
    if stage is None:
        return None
    points = tuple(sorted(stage.front, key=lambda point: point.tolerance))
    others = [row for row in report.rows_of_scene(run.scene) if not row.stage.front]
    beside = [_beside(points, row) for row in others if row.metric("discrete_terminal_error") is not None and row.stage.cost is not None]
    link = report.link(run)
    return Exactness(run, link, points, _plot(points, beside, link), beside)


def _beside(points: tuple[FrontPointRecord, ...], row: Row) -> Beside:
    missed, price = row.metric("discrete_terminal_error") or 0.0, row.stage.cost or 0.0
    loose, tight = least_within(points, missed)
    near = missed < _edge(points) and tight is not None
    if near:
        loose = None  # it reaches the goal, but for rounding
    if tight is None:
        least = "no point is as near"
    elif loose is None:
        least = cost(tight)
    else:
        least = f"{cost(loose)} to {cost(tight)}"
    if tight is not None and price > tight * (1 + _SAME):
        above = percent(price / tight - 1)
    elif loose is not None and price < loose * (1 - _SAME):
        above = "below the front: a better front exists"
    elif tight is not None and abs(price - tight) <= _SAME * tight:
        above = _ON_IT
    elif near and tight is not None:
        above = f"{percent(price / tight - 1)}, for missing the goal by more"
    else:
        above = "between its points" if loose is not None else "looser than all its points"
    return Beside(row, missed, price, least, above)


def _edge(points: tuple[FrontPointRecord, ...]) -> float:
    """The smallest error of the plot: a part of the smallest tolerance that is not 0."""
    return _EDGE * min((point.tolerance for point in points if point.tolerance > 0), default=1e-3)


def _plot(points: tuple[FrontPointRecord, ...], beside: list[Beside], link: str) -> Plot:
    priced = [(point, point.cost) for point in points if point.cost is not None]
    edge = _edge(points)
    costs = [price for _, price in priced] + [item.price for item in beside]
    errors = [edge, *(max(point.tolerance, edge) for point, _ in priced), *(max(item.missed, edge) for item in beside)]
    along = "terminal error on the grid, exact contact (norm of positions and velocities)"
    x, y = Axis.fitted(along, "", errors, log=True, margin=0.04), Axis.fitted("cost", "", costs, log=is_wide(costs), margin=0.08)
    keys = [Key("front", "least cost found within a tolerance (exact contact)"), Key("front", "its points", "diamond")]
    keys += [Key("indirect", "relaxed stage", "circle"), Key("direct", "direct stage", "square")]
    plot = Plot("Least cost of the exact problem against terminal error", x, y, width=720, height=420, keys=keys)
    plot.line("front", "front", [max(point.tolerance, edge) for point, _ in priced], [price for _, price in priced])
    for point, price in priced:
        where = f", {windows_text(point.windows)}" if point.windows else ""
        tip = f"Within {error(point.tolerance)}: cost {cost(price)}, terminal error {error(point.terminal_error)}{where}"
        plot.point(max(point.tolerance, edge), price, "front", "diamond", tip, link)
    for item in beside:
        kind = item.row.stage.kind
        tip = f"{item.row.label}: cost {cost(item.price)}, terminal error {error(item.missed)}, least known {item.least}"
        plot.point(max(item.missed, edge), item.price, kind, "square" if kind == "direct" else "circle", tip, item.row.link)
    plot.name_points([(max(item.missed, edge), item.price, item.row.name) for item in beside if item.above == _ON_IT])
    plot.words = (
        f"{count(len(priced), 'point')} of the front, from cost {cost(priced[0][1])} within {error(priced[0][0].tolerance)} "
        f"to {cost(priced[-1][1])} within {error(priced[-1][0].tolerance)}; {count(len(beside), 'stage')}. What misses the goal by less than "
        f"{error(edge)} is drawn at the left edge."
    )
    return plot
