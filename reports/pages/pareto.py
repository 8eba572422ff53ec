"""Scatters of all methods on a scene: CPU time against error and cost, cost against terminal error.

Costs are compared only among plans whose judged replay ends within the scene's limits; the front is
drawn through those that hold. A plan that ends farther away has traded the miss for its cost, and
no exchange rate is assumed.
"""

from __future__ import annotations

from collections.abc import Callable

from models.results.run import SceneRecord
from models.results.verdict import TRACKED, Metric
from reports.pages.section import Report, Section
from reports.plots import Axis, Key, Plot, is_wide
from reports.rows import Row, known_cost
from reports.wording import cost, count, error, listing, seconds, spaced, times

# Smallest drawn error: rounding.
SMALLEST = 1e-12
# Smallest drawn CPU time, a clock's tick [s].
TICK = 1e-3
# Style and words by family of the last method: the paper's three, and ours.
FAMILIES = {
    "relaxed": ("c1", "relaxed contact"),
    "gradient": ("c3", "gradient descent"),
    "exact": ("c0", "exact contact"),
    "ours": ("c2", "ours"),
}
_OF_PAPER = {
    "relaxed_lcp": "relaxed",
    "softplus_dc": "relaxed",
    "softplus_gd": "gradient",
    "relu_gd": "gradient",
    "strict_lcp": "exact",
}
_ENDS = (
    (
        "replay_terminal_position_error",
        "Cost against terminal position error, after the replay",
        "terminal position error",
    ),
    (
        "replay_terminal_velocity_error",
        "Cost against terminal velocity error, after the replay",
        "terminal velocity error",
    ),
)
# Relative difference of equal errors: plans on one grid share its error.
_SAME_ERROR = 0.05
# Relative difference of equal costs: two solves of one problem.
_SAME_COST = 1e-3
# Largest quoted ratio of errors.
_MANY = 1000.0

_FREE = "This scene has no inputs: nothing is planned, so there are no methods to compare. Its free motion is replayed and judged all the same."
_NOTHING = "No stage gave a plan that could be replayed, so there is nothing to compare."

Point = tuple[float, float, Row]


def build(report: Report, scene: SceneRecord) -> Section | None:
    """Return the section of one scene, None without stages.

    - failed: (row, reason) of methods without a comparable plan.
    - refused: pipelines that do not apply.
    - nothing: reason for missing plots.
    """
    rows = report.rows_of_scene(scene)
    ran = [row for row in rows if row.stage.outcome != "refused"]
    if not rows:
        return None
    views = (
        [view for view in (_error_view(ran), _cost_view(scene, ran)) if view is not None]
        if scene.inputs
        else []
    )
    values = {
        "views": views,
        "failed": [(row, reason) for row in ran if (reason := _why_absent(row))]
        if scene.inputs
        else [],
        "refused": list(
            dict.fromkeys(row.run.pipeline for row in rows if row.stage.outcome == "refused")
        ),
        "nothing": "" if views else _NOTHING if scene.inputs else _FREE,
    }
    return Section(
        f"pareto-{report.scenes.index(scene) + 1}",
        "All methods: speed against error",
        "scene.html#pareto",
        values,
    )


def cpu(row: Row) -> float:
    """Return the CPU seconds of a stage, including the stages before."""
    return sum(stage.seconds.cpu for stage in row.chain)


def replay_error(row: Row) -> Metric | None:
    """Return the metric of the judged replay."""
    return row.stage.judged("replay_error")


def arrives(row: Row) -> bool:
    """Return whether the replay meets the scene's limits on the terminal error, if any."""
    return all(metric.ok is True for metric in _terminal(row))


def _terminal(row: Row) -> list[Metric]:
    """Return the limited terminal errors of the judged replay, else of the plan's own grid."""
    limited = [
        metric
        for metric in row.stage.metrics
        if "terminal" in metric.name and metric.limit is not None
    ]
    name = f"{TRACKED}replay_terminal" if row.stage.is_tracked else "replay_terminal"
    replayed = [metric for metric in limited if metric.name.startswith(name)]
    return replayed or [
        metric for metric in limited if not metric.name.startswith(("replay", TRACKED))
    ]


def _why_absent(row: Row) -> str:
    stage, metric = row.stage, replay_error(row)
    if metric is None:
        words = stage.message.split(". ")[0].rstrip(".") if stage.message else ""
        return f"{spaced(stage.outcome)}, {stage.verdict}" + (f": {words}" if words else "")
    if metric.value is None:
        return f"its replay error is not known: {metric.reason}"
    return ""


def _error_view(rows: list[Row]) -> tuple[Plot, str] | None:
    points = [
        (max(cpu(row), TICK), value, row) for row in rows if (value := told_error(row)) is not None
    ]
    if not points:
        return None
    unit = next(metric.unit for _, _, row in points if (metric := replay_error(row)))
    axis = Axis.fitted("replay error", unit, [y for _, y, _ in points], log=True, margin=0.06)
    plot = _against_time("CPU time against replay error", axis, points, unbeaten(points), error)
    conclusion = _concluded(
        unbeaten([point for point in points if point[2].holds]),
        lambda y: f"replay error {error(y)}{' ' + unit if unit in ('m', 'rad') else ''}",
        lambda before, after: f"{_nearer(before / after)} nearer to its replay",
        _SAME_ERROR,
    )
    return plot, conclusion or _nothing_holds(len(points))


def told_error(row: Row) -> float | None:
    """Return the larger of the replay error and the replay's own error."""
    metric, replay = replay_error(row), row.stage.replay
    if metric is None or metric.value is None:
        return None
    return max(metric.value, (replay.error_estimate if replay else None) or 0.0, SMALLEST)


def _cost_view(scene: SceneRecord, rows: list[Row]) -> tuple[Plot, str] | None:
    plans = [row for row in rows if row.stage.cost is not None and replay_error(row) is not None]
    points = [
        (max(cpu(row), TICK), price, row)
        for row in plans
        if arrives(row) and (price := row.stage.cost) is not None
    ]
    off = len(plans) - len(points)
    if not points:
        return None
    known = known_cost(scene)
    prices = [y for _, y, _ in points] + ([known[1]] if known else [])
    lasting = unbeaten([point for point in points if point[2].holds])
    plot = _against_time(
        "CPU time against cost at equal terminal error", _costs(prices), points, lasting, cost
    )
    if known:
        plot.level(known[1], f"{known[0]}: {cost(known[1])}")

    def cheaper(before: float, after: float) -> str:
        return f"{100 * (1 - after / before):.2g} % cheaper" if before > 0 else "cheaper"

    conclusion = _concluded(lasting, lambda y: f"cost {cost(y)}", cheaper, _SAME_COST)
    excluded = (
        f" Not compared, because the replay ends farther from the goal than the scene allows: {count(off, 'plan')}."
        if off
        else ""
    )
    return plot, (conclusion or _nothing_holds(len(points))) + excluded


def _nothing_holds(plans: int) -> str:
    return f"None of {count(plans, 'plan')} holds, so there is none to recommend."


def _concluded(
    front: list[Point],
    value: Callable[[float], str],
    gain: Callable[[float, float], str],
    same: float,
) -> str:
    """Return a conclusion from a front, the cheapest first: costs of the first and better plans."""
    if not front:
        return ""
    steps = [front[0]]
    for point in front[1:]:
        if point[1] < steps[-1][1] * (1 - same) or steps[-1][1] <= 0:
            steps.append(point)
    (first, least, row), rest = steps[0], steps[1:]
    by = f" by more than {100 * same:g} %" if len(steps) < len(front) else ""
    text = f"The least CPU time for a plan that holds is {seconds(first)} s ({row.named}), {value(least)}."
    if not rest:
        return f"{text} No other plan that holds is better{by}, whatever time it takes."
    after, better, second = rest[0]
    detail = f"{seconds(after)} s ({second.named}): {value(better)}, {gain(least, better)}"
    text += f" The next one that is better{by} takes {_longer(after / first)}, {detail}."
    if len(rest) == 1:
        return f"{text} More time buys nothing further."
    last, best, third = rest[-1]
    detail = f"{seconds(last)} s ({third.named}): {value(best)}, {gain(least, best)}"
    return f"{text} The best takes {_longer(last / first)} as the first, {detail}."


def _nearer(ratio: float) -> str:
    return times(ratio) if ratio <= _MANY else f"more than {times(_MANY)}"


def _longer(ratio: float) -> str:
    return f"{times(ratio)} as long" if ratio >= 1.05 else "as long"


def ends(report: Report, scene: SceneRecord) -> Section | None:
    """Return plots of cost against final positions and velocities, None without values."""
    rows = report.rows_of_scene(scene)
    plots, best = [], []
    for name, title, quantity in _ENDS:
        known = [(row.metric(name), row.stage.cost, row) for row in rows]
        points = [
            (max(value, SMALLEST), price, row)
            for value, price, row in known
            if value is not None and price is not None
        ]
        if points:
            front = unbeaten(points)
            plots.append(_against_cost(scene, name, title, quantity, points, front))
            best = best or [row for *_, row in front]
    if not plots:
        return None
    absent = [row for row in rows if row.stage.cost is None or row.metric(_ENDS[0][0]) is None]
    anchor = f"front-{report.scenes.index(scene) + 1}"
    return Section(
        anchor,
        "Cost against terminal error",
        "scene.html#ends",
        {"plots": plots, "best": best, "absent": absent},
    )


def unbeaten(points: list[Point]) -> list[Point]:
    """Return the lower-left front of (x, y, row), from the left."""
    front: list[Point] = []
    for point in sorted(points, key=lambda point: point[:2]):
        if not front or point[1] < front[-1][1]:
            front.append(point)
    return front


def draw_front(plot: Plot, corners: list[tuple[float, float]]) -> None:
    """Draw the staircase through the points of a front, from the left."""
    path: list[tuple[float, float]] = []
    for x, y in corners:
        path += [(x, path[-1][1] if path else plot.y.high), (x, y)]
    if path:
        path.append((plot.x.high, path[-1][1]))
        plot.line("front", "front", [x for x, _ in path], [y for _, y in path])


def keys(front: str) -> list[Key]:
    """Return the legend of a scatter; front: meaning of its line."""
    families = [Key(style, words, "circle") for style, words in FAMILIES.values()]
    return [*families, Key("c2 full", "filled: holds", "circle"), Key("front", front)]


def style_of(row: Row) -> str:
    """Return the CSS class of a stage: its family, filled if the plan holds."""
    return FAMILIES[_OF_PAPER.get(row.stage.method, "ours")][0] + (" full" if row.holds else "")


def _scatter(
    title: str,
    x: Axis,
    y: Axis,
    points: list[Point],
    front: list[Point],
    line: str,
    tip: Callable[[Point], str],
) -> Plot:
    """Return a scatter with links to runs, and its front with names; line: meaning of the front."""
    plot = Plot(title, x, y, width=720, height=400, keys=keys(line))
    draw_front(plot, [point[:2] for point in front])
    for point in points:
        plot.point(*point[:2], style_of(point[2]), "circle", tip(point), point[2].link)
    plot.name_points([(left, up, row.name) for left, up, row in front])
    return plot


def _costs(prices: list[float]) -> Axis:
    return Axis.fitted("cost", "", prices, log=is_wide(prices), margin=0.1)


def _against_time(
    title: str, y_axis: Axis, points: list[Point], front: list[Point], said: Callable[[float], str]
) -> Plot:
    def tip(point: Point) -> str:
        x, y, row = point
        ends = f", ends off the goal by {row.ends}" if row.ends else ""
        stage = f"{row.label}, pipeline {row.run.pipeline}, stage {row.stage.index + 1}"
        return (
            f"{stage}: {seconds(x)} CPU s, {y_axis.quantity} {said(y)}{ends}, {row.stage.verdict}"
        )

    x_axis = Axis.fitted(
        "CPU time, with the stages before", "s", [x for x, _, _ in points], log=True, margin=0.06
    )
    plot = _scatter(
        title, x_axis, y_axis, points, front, "front: no stage is both faster and better", tip
    )
    steps = [f"{row.label} ({seconds(x)} s, {said(y)})" for x, y, row in front]
    where = f"on the front, the fastest first: {listing(steps)}" if steps else "none on a front"
    plot.words = f"{count(len(points), 'stage')}; {where}."
    return plot


def _against_cost(
    scene: SceneRecord,
    name: str,
    title: str,
    quantity: str,
    points: list[Point],
    front: list[Point],
) -> Plot:
    def tip(point: Point) -> str:
        row = point[2]
        return f"{row.label}: cost {cost(point[1])}, {row.ends}, {row.stage.verdict}"

    known = known_cost(scene)
    units = {metric.unit for *_, row in points if (metric := row.stage.metric(name))}
    x_axis = Axis.fitted(
        quantity,
        units.pop() if len(units) == 1 else "",
        [x for x, *_ in points],
        log=True,
        margin=0.06,
    )
    y_axis = _costs([price for _, price, _ in points] + ([known[1]] if known else []))
    plot = _scatter(
        title, x_axis, y_axis, points, front, "front: no stage is both cheaper and closer", tip
    )
    if known:
        plot.level(known[1], f"{known[0]}: {cost(known[1])}")
    steps = [
        f"{row.label} (cost {cost(price)} at {error(row.metric(name))})" for _, price, row in front
    ]
    plot.words = (
        f"{count(len(points), 'stage')}; on the front, from the smallest error: {listing(steps)}."
    )
    return plot
