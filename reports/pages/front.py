"""Cost against terminal error of all rows after the replay: a cost means nothing without its error."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.section import Report, Section
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import SceneRecord
from reports.rows import Row, known_cost
from reports.wording import cost, count, error, listing

_ERRORS = (
    ("replay_terminal_error", "After the replay (continuous dynamics)", "terminal error after replay"),
    ("discrete_terminal_error", "On the plan's own grid, with the true contact law", "terminal error on the grid"),
)
# Below this an error is a rounding error: drawn at the edge, so that it does not squeeze the rest.
_SMALLEST = 1e-10
# Costs that span more than this are drawn on a logarithmic axis.
_WIDE = 20.0


@dataclass(frozen=True)
class Front:
    """The plots of one scene and the rows that no other row beats in both cost and error."""

    scene: SceneRecord
    plots: list[Plot]
    best: list[Row]
    absent: list[Row]


def build(report: Report) -> Section | None:
    """The section, or None where no stage has a cost and an error."""
    fronts = [_front(scene, report.rows_of_scene(scene)) for scene in report.scenes]
    fronts = [front for front in fronts if front.plots]
    return Section("front", "Cost against terminal error", "front.html", {"fronts": fronts}) if fronts else None


def unbeaten(points: list[tuple[float, float, Row]]) -> list[tuple[float, float, Row]]:
    """The lower-left front of (error, cost, row): each point is cheaper than all with a smaller error."""
    front: list[tuple[float, float, Row]] = []
    for point in sorted(points, key=lambda point: point[:2]):
        if not front or point[1] < front[-1][1]:
            front.append(point)
    return front


def draw_front(plot: Plot, corners: list[tuple[float, float]]) -> None:
    """The staircase through the points of a front, from the left; nothing where there is none."""
    path: list[tuple[float, float]] = []
    for x, y in corners:
        path += [(x, path[-1][1] if path else plot.y.high), (x, y)]
    if path:
        path.append((plot.x.high, path[-1][1]))
        plot.line("front", "front", [x for x, _ in path], [y for _, y in path])


def _front(scene: SceneRecord, rows: list[Row]) -> Front:
    plots: list[Plot] = []
    best: list[Row] = []
    for name, title, quantity in _ERRORS:
        points = [(value, row.stage.cost, row) for row in rows if (value := row.metric(name)) is not None and row.stage.cost is not None]
        if points:
            front = unbeaten(points)
            plots.append(_plot(scene, title, quantity, points, front))
            best = best or [row for _, _, row in front]
    absent = [row for row in rows if row.stage.cost is None or row.metric("replay_terminal_error") is None]
    return Front(scene, plots, best, absent)


def _plot(
    scene: SceneRecord, title: str, quantity: str, points: list[tuple[float, float, Row]], front: list[tuple[float, float, Row]]
) -> Plot:
    known = known_cost(scene)
    costs = [point[1] for point in points] + ([known[1]] if known else [])
    units = {metric.unit for _, _, row in points if (metric := row.stage.metric("replay_terminal_error"))}
    wide = min(costs) > 0 and max(costs) / min(costs) > _WIDE
    plot = Plot(
        title,
        Axis.fitted(
            quantity, units.pop() if len(units) == 1 else "", [max(point[0], _SMALLEST) for point in points], log=True, margin=0.06
        ),
        Axis.fitted("cost", "", costs, log=wide, margin=0.1),
        width=720,
        height=400,
        keys=[
            Key("indirect", "relaxed stage", "circle"),
            Key("direct", "direct stage", "square"),
            Key("front", "front: no stage is both cheaper and closer"),
        ],
    )
    if known:
        plot.level(known[1], f"best known cost of an exact plan: {cost(known[1])}")
    draw_front(plot, [(max(missed, _SMALLEST), price) for missed, price, _ in front])
    for missed, price, row in points:
        style = row.stage.kind
        marker = "square" if style == "direct" else "circle"
        tip = f"{row.label}: cost {cost(price)}, terminal error {error(missed)}, {row.stage.verdict}"
        plot.point(max(missed, _SMALLEST), price, style, marker, tip, row.link)
    plot.name_points([(max(missed, _SMALLEST), price, row.name) for missed, price, row in front])
    steps = [f"{row.label} (cost {cost(price)} at {error(missed)})" for missed, price, row in front]
    plot.words = f"{count(len(points), 'stage')}; on the front, from the smallest error: {listing(steps)}."
    return plot
