"""Cost against terminal error of all stages on a scene after the replay, positions and velocities apart: a cost means nothing without its error."""

from __future__ import annotations

from reports.pages.section import Report, Section
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import SceneRecord
from reports.rows import Row, known_cost
from reports.wording import cost, count, error, listing

_ERRORS = (
    ("replay_terminal_position_error", "Cost against terminal position error, after the replay", "terminal position error"),
    ("replay_terminal_velocity_error", "Cost against terminal velocity error, after the replay", "terminal velocity error"),
)
# Below this an error is a rounding error: drawn at the edge, so that it does not squeeze the rest.
_SMALLEST = 1e-10
# Costs that span more than this are drawn on a logarithmic axis.
_WIDE = 20.0


def build(report: Report, scene: SceneRecord) -> Section | None:
    """The section of one scene, or None where no stage on it has a cost and an error."""
    rows = report.rows_of_scene(scene)
    plots, best = [], []
    for name, title, quantity in _ERRORS:
        points = [(value, row.stage.cost, row) for row in rows if (value := row.metric(name)) is not None and row.stage.cost is not None]
        if points:
            front = unbeaten(points)
            plots.append(_plot(scene, name, title, quantity, points, front))
            best = best or [row for _, _, row in front]
    if not plots:
        return None
    absent = [row for row in rows if row.stage.cost is None or row.metric(_ERRORS[0][0]) is None]
    anchor = f"front-{report.scenes.index(scene) + 1}"
    return Section(anchor, "Cost against terminal error", "front.html", {"plots": plots, "best": best, "absent": absent})


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


def _plot(
    scene: SceneRecord, name: str, title: str, quantity: str, points: list[tuple[float, float, Row]], front: list[tuple[float, float, Row]]
) -> Plot:
    known = known_cost(scene)
    costs = [point[1] for point in points] + ([known[1]] if known else [])
    units = {metric.unit for _, _, row in points if (metric := row.stage.metric(name))}
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
        tip = f"{row.label}: cost {cost(price)}, {row.ends}, {row.stage.verdict}"
        plot.point(max(missed, _SMALLEST), price, style, marker, tip, row.link)
    plot.name_points([(max(missed, _SMALLEST), price, row.name) for missed, price, row in front])
    steps = [f"{row.label} (cost {cost(price)} at {error(missed)})" for missed, price, row in front]
    plot.words = f"{count(len(points), 'stage')}; on the front, from the smallest error: {listing(steps)}."
    return plot
