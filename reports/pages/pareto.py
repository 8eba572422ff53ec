"""What a plan costs to find against how good it is: CPU time against replay error, and against cost at equal terminal error, scene by scene.

Equal means: within what the scene itself allows. A cost is compared only among plans whose judged replay ends within the scene's limits on the terminal
error (the scene of a free end has none: there the last state is in the cost), and the front is drawn through those that hold, with feedback or without.
A plan that ends farther away has bought its lower cost with the miss; no price of a metre would make the two comparable, so none is invented.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from reports.judged import TRACKED, is_tracked, judged_metric
from reports.pages.front import draw_front, unbeaten
from reports.pages.section import Report, Section
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import MetricRecord, SceneRecord
from reports.rows import Row, known_cost
from reports.wording import cost, count, error, listing, seconds, spaced, times

# Below this an error is a rounding error: drawn at the edge, so that it does not squeeze the rest.
_SMALLEST = 1e-12
# A stage that took less than a tick of the clock is drawn at a tick.
_TICK = 1e-3
# Costs that span more than this are drawn on a logarithmic axis.
_WIDE = 20.0
# What is better by less than this, relatively, is not worth a sentence: plans on one grid share its error, and two solves of one problem their cost.
_SAME_ERROR, _SAME_COST = 0.05, 1e-3
# Beyond this a ratio of errors says no more than that one of them is nearly none.
_MANY = 1000.0

_FREE = (
    "This scene has no inputs: nothing is planned, so there are no methods to compare. Its free motion is replayed and judged all the same."
)

_NOTHING = "No stage gave a plan that could be replayed, so there is nothing to compare."

Point = tuple[float, float, Row]


@dataclass(frozen=True)
class ParetoView:
    """A plot and the sentence that concludes from its numbers."""

    plot: Plot
    sentence: str


def build(report: Report, scene: SceneRecord) -> Section | None:
    """The section of one scene, or None where no stage on it is stored.

    failed: (row, why it has no point) of methods that gave no plan to compare; refused: pipelines that do not apply; nothing: why there is no plot, where
    there is none.
    """
    rows = report.rows_of_scene(scene)
    ran = [row for row in rows if row.stage.outcome != "refused"]
    if not rows:
        return None
    views = [view for view in (_error_view(ran), _cost_view(scene, ran)) if view is not None] if scene.inputs else []
    values = {
        "views": views,
        "failed": [(row, reason) for row in ran if (reason := _why_absent(row))] if scene.inputs else [],
        "refused": list(dict.fromkeys(row.run.pipeline for row in rows if row.stage.outcome == "refused")),
        "nothing": "" if views else _NOTHING if scene.inputs else _FREE,
    }
    return Section(f"pareto-{report.scenes.index(scene) + 1}", "CPU time against error and cost", "pareto.html", values)


def cpu(row: Row) -> float:
    """CPU seconds of a stage and of those it starts from."""
    return sum(stage.seconds.stage_cpu for stage in row.chain)


def replay_error(row: Row) -> MetricRecord | None:
    """Of the replay that is judged."""
    return judged_metric(row.stage, "replay_error")


def arrives(row: Row) -> bool:
    """Whether its replay ends within the scene's limits on the terminal error; True where there is none."""
    return all(metric.ok is True for metric in _terminal(row))


def _terminal(row: Row) -> list[MetricRecord]:
    """The limited terminal errors of the judged replay; where the scene limits none of a replay, those on the plan's own grid."""
    limited = [metric for metric in row.stage.metrics if "terminal" in metric.name and metric.limit is not None]
    name = f"{TRACKED}replay_terminal" if is_tracked(row.stage) else "replay_terminal"
    return [metric for metric in limited if metric.name.startswith(name)] or [
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


def _error_view(rows: list[Row]) -> ParetoView | None:
    points = [(max(cpu(row), _TICK), value, row) for row in rows if (value := _told_error(row)) is not None]
    if not points:
        return None
    unit = next(metric.unit for _, _, row in points if (metric := replay_error(row)))
    axis = Axis.fitted("replay error", unit, [y for _, y, _ in points], log=True, margin=0.06)
    plot = _plot("CPU time against replay error", axis, points, unbeaten(points), error)
    said = _concluded(
        unbeaten([point for point in points if point[2].holds]),
        lambda y: f"replay error {error(y)}{' ' + unit if unit in ('m', 'rad') else ''}",
        lambda before, after: f"{_nearer(before / after)} nearer to its replay",
        _SAME_ERROR,
    )
    return ParetoView(plot, said or _nothing_holds(len(points)))


def _told_error(row: Row) -> float | None:
    """The replay error, or the replay's own error where that is larger: less cannot be told apart."""
    metric, replay = replay_error(row), row.stage.replay
    if metric is None or metric.value is None:
        return None
    return max(metric.value, (replay.error_estimate if replay else None) or 0.0, _SMALLEST)


def _cost_view(scene: SceneRecord, rows: list[Row]) -> ParetoView | None:
    plans = [row for row in rows if row.stage.cost is not None and replay_error(row) is not None]
    points = [(max(cpu(row), _TICK), price, row) for row in plans if arrives(row) and (price := row.stage.cost) is not None]
    off = len(plans) - len(points)
    if not points:
        return None
    known = known_cost(scene)
    prices = [y for _, y, _ in points] + ([known[1]] if known else [])
    wide = min(prices) > 0 and max(prices) / min(prices) > _WIDE
    lasting = unbeaten([point for point in points if point[2].holds])
    plot = _plot(
        "CPU time against cost at equal terminal error", Axis.fitted("cost", "", prices, log=wide, margin=0.1), points, lasting, cost
    )
    if known:
        plot.level(known[1], f"{known[0]}: {cost(known[1])}")
    said = _concluded(
        lasting,
        lambda y: f"cost {cost(y)}",
        lambda before, after: f"{100 * (1 - after / before):.2g} % cheaper" if before > 0 else "cheaper",
        _SAME_COST,
    )
    left = f" Not compared, because the replay ends farther from the goal than the scene allows: {count(off, 'plan')}." if off else ""
    return ParetoView(plot, (said or _nothing_holds(len(points))) + left)


def _nothing_holds(plans: int) -> str:
    return f"None of {count(plans, 'plan')} holds, so there is none to recommend."


def _concluded(front: list[Point], value: Callable[[float], str], gain: Callable[[float, float], str], same: float) -> str:
    """From the plans that hold and that no other such plan beats, cheapest first: what the first costs, and what each better one costs more."""
    if not front:
        return ""
    steps = [front[0]]
    for point in front[1:]:
        if point[1] < steps[-1][1] * (1 - same) or steps[-1][1] <= 0:
            steps.append(point)
    (first, least, row), rest = steps[0], steps[1:]
    by = f" by more than {100 * same:g} %" if len(steps) < len(front) else ""
    said = f"The least CPU time for a plan that holds is {seconds(first)} s ({row.named}), {value(least)}."
    if not rest:
        return f"{said} No other plan that holds is better{by}, whatever time it takes."
    after, better, second = rest[0]
    said += (
        f" The next one that is better{by} takes {_longer(after / first)}, {seconds(after)} s ({second.named}): "
        f"{value(better)}, {gain(least, better)}."
    )
    if len(rest) == 1:
        return f"{said} More time buys nothing further."
    last, best, third = rest[-1]
    return (
        f"{said} The best takes {_longer(last / first)} as the first, {seconds(last)} s ({third.named}): {value(best)}, "
        f"{gain(least, best)}."
    )


def _nearer(ratio: float) -> str:
    return times(ratio) if ratio <= _MANY else f"more than {times(_MANY)}"


def _longer(ratio: float) -> str:
    return f"{times(ratio)} as long" if ratio >= 1.05 else "as long"


def _plot(title: str, y_axis: Axis, points: list[Point], front: list[Point], said: Callable[[float], str]) -> Plot:
    plot = Plot(
        title,
        Axis.fitted("CPU time, with the stages before", "s", [x for x, _, _ in points], log=True, margin=0.06),
        y_axis,
        width=720,
        height=400,
        keys=[
            Key("direct", "holds", "square"),
            Key("indirect", "does not hold", "circle"),
            Key("front", "front: no stage is both faster and better"),
        ],
    )
    draw_front(plot, [(x, y) for x, y, _ in front])
    for x, y, row in points:
        holds = row.holds
        quantity = y_axis.quantity
        ends = f", ends off the goal by {row.ends}" if row.ends else ""
        tip = f"{row.label}, pipeline {row.run.pipeline}, stage {row.stage.index + 1}: {seconds(x)} CPU s, {quantity} {said(y)}{ends}, {row.stage.verdict}"
        plot.point(x, y, "direct" if holds else "indirect", "square" if holds else "circle", tip, row.link)
    plot.name_points([(x, y, row.name) for x, y, row in front])
    steps = [f"{row.label} ({seconds(x)} s, {said(y)})" for x, y, row in front]
    plot.words = f"{count(len(points), 'stage')}" + (
        f"; on the front, the fastest first: {listing(steps)}." if steps else "; none on a front."
    )
    return plot
