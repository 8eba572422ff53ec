"""Sweeps of a campaign: metrics against a number that runs differ in, and against eps.

Three carts at k = 30, 60, 120 N/m by one pipeline are a sweep. For a scene: Figs. 4-6 of the paper,
plans of a relaxation at decreasing eps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from models.results.run import QuantityRecord, RunRecord, SceneRecord
from models.results.verdict import HOLD
from reports.pages.section import Report, Section
from reports.paper import TIGHTENING_FIGURES
from reports.plots import Axis, Key, Line, Plot, is_wide, over_time
from reports.rows import Row
from reports.traces import Trace
from reports.wording import capital, count, error, listing, number, small, spaced, with_unit

# Metrics that are not folded.
_FIRST = ("replay_error", "replay_terminal_position_error", "replay_terminal_velocity_error")
_MARKERS = ("circle", "square", "diamond", "triangle")
# CSS class and marker of a curve.
Style = tuple[str, str]
# Number of colours of curves.
_COLOURS = 6
# Largest number of varied quantities of a sweep.
_MOST = 3

_PAIR = 2


class Quantity(NamedTuple):
    """A varied number: `k` [N/m] of the scene, `start q1` [m], `mpcc work`."""

    name: str
    unit: str = ""


class Mark(NamedTuple):
    """A value y at x of a curve; tip: in words; holds: the plan holds."""

    curve: str
    x: float
    y: float
    tip: str
    link: str
    holds: bool


class SweptRun(NamedTuple):
    """A run of a sweep; curve: other values and the pipeline; x: on the axis."""

    run: RunRecord
    link: str
    curve: str
    x: float


class Sweep(NamedTuple):
    """One sweep; first: plots of cost, errors and time; others: of further metrics that vary."""

    title: str
    anchor: str
    axis: Quantity
    runs: list[SweptRun]
    keys: list[Key]
    first: list[Plot]
    others: list[Plot]
    words: str


def build(report: Report) -> Section | None:
    """Return the section, None without sweeps."""
    result = [
        sweep
        for place, group in enumerate(_groups(report.stored.runs), 1)
        if (sweep := _sweep(report, group, f"sweep-{place}"))
    ]
    if not result:
        return None
    sentence = f"{count(len(result), 'sweep')}: {listing([sweep.title for sweep in result])}; every metric against the swept number."
    entries = tuple((sweep.anchor, sweep.title) for sweep in result)
    return Section(
        "sweeps", "Sweeps", "campaign.html#sweeps", {"sweeps": result}, entries, sentence
    )


def _groups(runs: Iterable[RunRecord]) -> list[list[RunRecord]]:
    groups: dict[object, list[RunRecord]] = {}
    for run in runs:
        if run.stages and run.verdict != "not applicable":
            groups.setdefault(
                (
                    _kind(run.scene),
                    tuple((stage.method, *_words(stage.options)) for stage in run.stages),
                ),
                [],
            ).append(run)
    return [group for group in groups.values() if len(group) > 1]


def _kind(scene: SceneRecord) -> tuple[object, ...]:
    """Return what scenes of a sweep must have in common."""
    parts = (
        scene.coordinates,
        scene.velocities,
        scene.inputs,
        scene.contacts,
        scene.frictions,
        scene.parameters,
    )
    names = tuple(tuple((item.name, item.unit) for item in part) for part in parts)
    return (*names, scene.source, tuple((shape.name, shape.kind) for shape in scene.shapes))


def _words(options: Mapping[str, object]) -> tuple[tuple[str, object], ...]:
    return tuple(
        (name, str(value)) for name, value in sorted(options.items()) if not _is_number(value)
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _numbers(run: RunRecord) -> dict[Quantity, float]:
    scene = run.scene
    result = {
        Quantity(item.name, item.unit): item.value
        for item in scene.parameters
        if item.value is not None
    }
    states = [*scene.coordinates, *scene.velocities]
    for what, values in (("start", scene.start), ("goal", scene.goal)):
        known = [
            (item, value) for item, value in zip(states, values, strict=False) if value is not None
        ]
        result |= {Quantity(f"{what} {item.name}", item.unit): value for item, value in known}
    result |= {Quantity("step h", "s"): scene.step, Quantity("steps"): float(scene.steps)}
    for stage in run.stages:
        numbers = {
            name: float(value)
            for name, value in stage.options.items()
            if isinstance(value, (int, float)) and _is_number(value)
        }
        result |= {
            Quantity(f"{stage.method} {spaced(name)}"): value for name, value in numbers.items()
        }
        if stage.eps:
            result[Quantity(f"ε of stage {stage.index + 1}")] = stage.eps
    return result


def _sweep(report: Report, runs: Sequence[RunRecord], anchor: str) -> Sweep | None:
    """Return the sweep of runs that differ in few numbers, along the one with most values."""
    values = [_numbers(run) for run in runs]
    common = [quantity for quantity in values[0] if all(quantity in other for other in values)]
    varied = [quantity for quantity in common if len({numbers[quantity] for numbers in values}) > 1]
    if not 0 < len(varied) <= _MOST:
        return None
    axis = max(varied, key=lambda quantity: len({numbers[quantity] for numbers in values}))
    # Quantities determined by the axis are not named, such as steps and their length.
    along = {numbers[axis] for numbers in values}
    others = [quantity for quantity in varied if quantity != axis]
    beside = [
        quantity
        for quantity in others
        if len({(numbers[axis], numbers[quantity]) for numbers in values}) > len(along)
    ]
    # An option with many values is a sweep of pipelines named after it, with two values it is not.
    of_method = axis.name.partition(" ")[0] in {stage.method for stage in runs[0].stages}
    option = len(varied) == 1 and of_method and len(along) > _PAIR
    several = len({run.pipeline for run in runs}) > 1 and not option
    swept = []
    for run, numbers in zip(runs, values, strict=True):
        parts = [
            f"{quantity.name} = {with_unit(number(numbers[quantity]), quantity.unit)}"
            for quantity in beside
        ]
        curve = ", ".join([run.pipeline, *parts] if several else parts) or (
            run.stages[-1].method if option else run.pipeline
        )
        swept.append(SweptRun(run, report.link(run), curve, numbers[axis]))
    swept.sort(key=lambda item: (item.curve, item.x))
    if not any(
        len({item.x for item in swept if item.curve == curve}) > 1
        for curve in {item.curve for item in swept}
    ):
        return None  # different pipelines, no sweep
    styles = styles_of(item.curve for item in swept)
    first = [_plot(axis, swept, styles, *asked) for asked in _asked(swept)]
    names = dict.fromkeys(
        metric.name
        for run in runs
        for metric in run.stages[-1].metrics
        if metric.name not in (*_FIRST, "cost")
    )
    others = [
        _plot(axis, swept, styles, spaced(name), _unit(runs, name), _of(name)) for name in names
    ]
    several_grids = len({(run.scene.step, run.scene.steps) for run in runs}) > 1
    return Sweep(
        f"{axis.name} on {_name([run.scene.name for run in runs], axis)}",
        anchor,
        axis,
        swept,
        keys_of(styles),
        [plot for plot in first if plot is not None],
        [plot for plot in others if plot is not None],
        _conclusion(axis, swept)
        + (" Grids differ: compare integral costs, not sums over steps." if several_grids else ""),
    )


def _name(names: Sequence[str], axis: Quantity) -> str:
    """Return the common beginning of swept scenes' names: three_cart of three_cart_k_30."""
    first, last = min(names), max(names)
    shared = next(
        (place for place, pair in enumerate(zip(first, last, strict=False)) if pair[0] != pair[1]),
        len(first),
    )
    begin = first if first == last else first[:shared].rpartition("_")[0]
    return begin.removesuffix("_" + axis.name.replace(" ", "_")) or first


def _asked(swept: Sequence[SweptRun]) -> list[tuple[str, str, Callable[[RunRecord], float | None]]]:
    runs = [item.run for item in swept]
    whole = all(run.integral_cost is None for run in runs)
    price = (
        ("cost", "", attrgetter("cost"))
        if whole
        else ("integral cost (cost times h)", "", attrgetter("integral_cost"))
    )
    errors = [(spaced(name), _unit(runs, name), _of(name)) for name in _FIRST]
    return [price, *errors, ("CPU time of solving", "s", attrgetter("solving_cpu"))]


def _of(name: str) -> Callable[[RunRecord], float | None]:
    def value(run: RunRecord) -> float | None:
        metric = run.stages[-1].judged(name)
        return None if metric is None else metric.value

    return value


def _unit(runs: Sequence[RunRecord], name: str) -> str:
    return next(
        (metric.unit for run in runs if (metric := run.stages[-1].metric(name)) is not None), ""
    )


def _plot(
    axis: Quantity,
    swept: Sequence[SweptRun],
    styles: Mapping[str, Style],
    name: str,
    unit: str,
    value: Callable[[RunRecord], float | None],
) -> Plot | None:
    marks = []
    for item in swept:
        metric_value = value(item.run)
        if metric_value is not None:
            where = f"{item.run.pipeline} on {item.run.scene.name}: {axis.name} {with_unit(number(item.x), axis.unit)}"
            tip = f"{where}, {name} {with_unit(number(metric_value, 4), unit)}, {item.run.verdict}"
            marks.append(
                Mark(item.curve, item.x, metric_value, tip, item.link, item.run.verdict in HOLD)
            )
    return draw_against(axis, name, unit, marks, styles)


def styles_of(curves: Iterable[str]) -> dict[str, Style]:
    """Return colour and marker of each curve."""
    return {
        curve: (f"c{place % _COLOURS}", _MARKERS[place % len(_MARKERS)])
        for place, curve in enumerate(dict.fromkeys(curves))
    }


def keys_of(styles: Mapping[str, Style]) -> list[Key]:
    """Return the legend, empty for a single curve."""
    return (
        [Key(style, curve, marker) for curve, (style, marker) in styles.items()]
        if len(styles) > 1
        else []
    )


def draw_against(
    axis: Quantity, name: str, unit: str, marks: Sequence[Mark], styles: Mapping[str, Style]
) -> Plot | None:
    """Return the plot of a metric against a number, None if either is constant."""
    if len({mark.y for mark in marks}) < 2 or len({mark.x for mark in marks}) < 2:
        return None
    xs, ys = [mark.x for mark in marks], [mark.y for mark in marks]
    across = Axis.fitted(axis.name, axis.unit, xs, log=is_wide(xs), margin=0.06)
    plot = Plot(
        f"{capital(name)} against {axis.name}",
        across,
        Axis.fitted(name, unit, ys, log=is_wide(ys), margin=0.08),
    )
    phrases = []
    for curve, (style, _) in styles.items():
        mine = sorted((mark.x, mark.y) for mark in marks if mark.curve == curve)
        if mine:
            plot.line(curve, style, [x for x, _ in mine], [y for _, y in mine])
            first, last = mine[0][1], mine[-1][1]
            phrases.append(f"{curve}: {number(first, 3)} to {with_unit(number(last, 3), unit)}")
    for mark in marks:
        style, marker = styles[mark.curve]
        plot.point(
            mark.x, mark.y, f"{style} full" if mark.holds else style, marker, mark.tip, mark.link
        )
    plot.words = f"{'; '.join(phrases)}. Filled: the plan holds."
    return plot


def _conclusion(axis: Quantity, swept: Sequence[SweptRun]) -> str:
    phrases = []
    for curve in dict.fromkeys(item.curve for item in swept):
        held = dict.fromkeys(
            item.x for item in swept if item.curve == curve and item.run.verdict in HOLD
        )
        values = [with_unit(number(x), axis.unit) for x in held]
        phrases.append(
            f"{curve} holds at {axis.name} = {listing(values)}"
            if values
            else f"{curve} holds at no value of {axis.name}"
        )
    return f"{'; '.join(phrases)}."


# Metrics drawn against eps.
_AGAINST = (
    "replay_terminal_position_error",
    "replay_terminal_velocity_error",
    "replay_error",
    "physics_scaled",
    "cost",
)
# Number of sequential colours, CSS classes s0 (loosest) to s5 (tightest).
_SHADES = 6


class TighteningCurve(NamedTuple):
    """The stages of one relaxation on one scene, loosest eps first, and their plots."""

    title: str
    anchor: str
    rows: list[Row]
    keys: list[Key]
    plots: list[Plot]
    absent: str


def tightening(report: Report, scene: SceneRecord) -> Section | None:
    """Return the sweeps over eps of one scene, None if no method has several."""
    rows = [
        row
        for row in report.rows_of_scene(scene)
        if row.stage.kind == "indirect" and row.stage.eps and len(row.methods) == 1
    ]
    # One sweep per method and pipeline: other options are no figure of the paper.
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        figure = TIGHTENING_FIGURES.get(row.stage.method, "") if row.stage.paper else ""
        groups.setdefault(
            (figure or "z", row.stage.method, "" if figure else row.run.pipeline), []
        ).append(row)
    sweeps: list[TighteningCurve] = []
    place = report.scenes.index(scene) + 1
    for (figure, _, pipeline), mine in sorted(groups.items(), key=lambda item: item[0]):
        if len(mine) > 1:
            ordered = sorted(mine, key=lambda row: -(row.stage.eps or 0.0))
            sweeps.append(
                _tightened(
                    report,
                    scene,
                    figure.rstrip("z"),
                    pipeline,
                    ordered,
                    f"tightening-{place}-{len(sweeps) + 1}",
                )
            )
    if not sweeps:
        return None
    figures = (
        "Figs. 4–6: plans" if any(sweep.title.startswith("Fig.") for sweep in sweeps) else "Plans"
    )
    entries = tuple((sweep.anchor, sweep.title) for sweep in sweeps)
    styles = styles_of(_curve(sweep) for sweep in sweeps)
    against = [plot for name in _AGAINST if (plot := _against(name, sweeps, styles)) is not None]
    values = {"sweeps": sweeps, "keys": keys_of(styles), "against": against}
    return Section(
        f"tightening-{place}",
        f"{figures} while ε is tightened",
        "scene.html#tightening",
        values,
        entries,
    )


def _curve(sweep: TighteningCurve) -> str:
    return sweep.title.partition(": ")[2] if sweep.title.startswith("Fig. ") else sweep.title


def _against(
    name: str, sweeps: Sequence[TighteningCurve], styles: Mapping[str, tuple[str, str]]
) -> Plot | None:
    marks, unit = [], ""
    for sweep in sweeps:
        for row in sweep.rows:
            metric, eps = row.stage.judged(name), row.stage.eps
            if metric is not None and metric.value is not None and eps:
                unit = metric.unit
                tip = f"{row.label}: {spaced(name)} {with_unit(number(metric.value, 3), unit)}, {row.stage.verdict}"
                marks.append(Mark(_curve(sweep), eps, metric.value, tip, row.link, row.holds))
    return draw_against(Quantity("ε"), spaced(name), unit, marks, styles)


def _tightened(
    report: Report, scene: SceneRecord, figure: str, pipeline: str, rows: list[Row], anchor: str
) -> TighteningCurve:
    lines, missing = [], []
    for index, row in enumerate(rows):
        plan = report.plan(row.run, row.stage)
        words = f"ε = {small(row.stage.eps)}"
        if plan is None:
            missing.append(words)
        else:
            lines.append((words, f"s{round(index * (_SHADES - 1) / max(1, len(rows) - 1))}", plan))
    return TighteningCurve(
        title=(f"{figure}: " if figure else "")
        + rows[0].stage.method_title
        + (f" ({pipeline})" if pipeline else ""),
        anchor=anchor,
        rows=rows,
        keys=[Key(style, words) for words, style, _ in lines],
        plots=_plots_of_plans(scene, lines),
        absent=f"No plan is stored for {', '.join(missing)}." if missing else "",
    )


def _plots_of_plans(scene: SceneRecord, lines: list[tuple[str, str, Trace]]) -> list[Plot]:
    units = list(dict.fromkeys(item.unit for item in scene.coordinates))
    plots = [
        _positions([item for item in scene.coordinates if item.unit == unit], unit, lines)
        for unit in units
    ]
    panels = [
        *(
            (f"lam_{item.name}", f"Contact force, {item.name}", "force", "N")
            for item in scene.contacts
        ),
        *((f"gap_{item.name}", f"Gap, {item.name}", "gap", "m") for item in scene.contacts),
        *((item.name, f"Input {item.name}", item.name, item.unit) for item in scene.inputs),
    ]
    for name, title, quantity, unit in panels:
        known = [
            (words, style, plan.t, plan.columns[name])
            for words, style, plan in lines
            if name in plan.columns
        ]
        plots.append(_single(title, quantity, unit, known))
    return [plot for plot in plots if plot is not None]


def _positions(
    items: Sequence[QuantityRecord], unit: str, lines: list[tuple[str, str, Trace]]
) -> Plot | None:
    data = [
        (item, words, (f"{item.name}, {words}", style, trace.t, values))
        for item in items
        for words, style, trace in lines
        if (values := trace.columns.get(item.name)) is not None
    ]
    plot = over_time(
        "Positions", "position", unit, [line for *_, line in data], height=300, margin=0.08
    )
    if plot is None:
        return None
    for item in items:
        mine = [line for other, _, line in data if other is item]
        if mine:
            plot.label(mine[-1][2][0], mine[-1][3][0], item.name, "strong")
    last = [(item, words, values) for item, words, (*_, values) in data if words == data[-1][1]]
    plot.words = " ".join(
        f"{item.name} {words}: from {error(values[0])} to {with_unit(number(values[-1], 3), unit)}."
        for item, words, values in last
    )
    return plot


def _single(title: str, quantity: str, unit: str, lines: Sequence[Line]) -> Plot | None:
    plot = over_time(title, quantity, unit, lines, zero=True)
    if plot is None:
        return None
    sentences = []
    for words, style, times, values in lines:
        peak = int(np.abs(values).argmax())
        when = times[min(peak, len(times) - 1)]
        sentences.append(
            f"{words}: largest size {with_unit(number(abs(values[peak]), 3), unit)} at {number(when, 3)} s."
        )
        if quantity == "force":
            plot.label(when, values[peak], words, style, anchor="middle")
    plot.words = " ".join(sentences)
    return plot
