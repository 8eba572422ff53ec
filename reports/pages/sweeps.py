"""Numbers that a campaign swept - parameters, starts, goals, grids, options, eps - and how every metric goes with them; seeds as a spread.

Three carts at k = 30, 60, 120 N/m by one pipeline are three runs that differ in one number: each metric is drawn against it. Runs that differ in the seed
of their method alone are one point: the median, with a bar from the least to the largest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from statistics import median

from reports.pages.section import Report, Section
from reports.plots import Axis, Key, Plot, is_wide
from reports.records.record import HOLD, RunRecord, SceneRecord
from reports.wording import capital, count, listing, number, spaced

SEED = "seed"
# Metrics that are drawn at once; the others are folded.
_FIRST = ("replay_error", "replay_terminal_position_error", "replay_terminal_velocity_error")
_MARKERS = ("circle", "square", "diamond", "triangle")
# CSS class and marker of a curve.
Style = tuple[str, str]
# More curves than colours and markers tell apart are drawn in the order of the campaign.
_COLOURS = 6
# Runs that differ in more numbers than this are other runs, not a sweep.
_MOST = 3
_PAIR = 2


@dataclass(frozen=True)
class Quantity:
    """A number that differs between runs: `k` [N/m] of the scene, `start q1` [m], `mpcc work`."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class Mark:
    """A value y at x of a curve; tip: in words; holds: whether its plan does."""

    curve: str
    x: float
    y: float
    tip: str
    link: str
    holds: bool


@dataclass(frozen=True)
class SweptRun:
    """A run at its values of what was swept. curve: the other values and the pipeline, in words; x: of the axis; seed: of its method, if it draws."""

    run: RunRecord
    link: str
    curve: str
    x: float
    seed: float | None


@dataclass(frozen=True)
class Sweep:
    """One sweep. first: plots of cost, errors and time; others: of every other metric that varies."""

    title: str
    anchor: str
    axis: Quantity
    runs: list[SweptRun]
    keys: list[Key]
    first: list[Plot]
    others: list[Plot]
    words: str


def build(report: Report) -> Section | None:
    """The section, or None where no runs differ in a number alone."""
    found = [sweep for place, group in enumerate(_groups(report.stored.runs), 1) if (sweep := _sweep(report, group, f"sweep-{place}"))]
    if not found:
        return None
    said = f"{count(len(found), 'sweep')}: {listing([sweep.title for sweep in found])}; every metric against the swept number."
    return Section(
        "sweeps", "Sweeps", "campaign.html#sweeps", {"sweeps": found}, tuple((sweep.anchor, sweep.title) for sweep in found), said
    )


def _groups(runs: Iterable[RunRecord]) -> list[list[RunRecord]]:
    """Runs that could differ in numbers alone: of scenes with the same quantities and equations, by the same methods, stage after stage."""
    found: dict[object, list[RunRecord]] = {}
    for run in runs:
        if run.stages and run.verdict != "not applicable":
            found.setdefault((_kind(run.scene), tuple((stage.method, *_words(stage.options)) for stage in run.stages)), []).append(run)
    return [group for group in found.values() if len(group) > 1]


def _kind(scene: SceneRecord) -> tuple[object, ...]:
    """What two scenes have in common that differ in numbers alone."""
    parts = (scene.coordinates, scene.velocities, scene.inputs, scene.contacts, scene.frictions, scene.parameters)
    names = tuple(tuple((item.name, item.unit) for item in part) for part in parts)
    return (*names, scene.source, tuple((shape.name, shape.kind) for shape in scene.shapes))


def _words(options: Mapping[str, object]) -> tuple[tuple[str, object], ...]:
    """Options that are no numbers."""
    return tuple((name, str(value)) for name, value in sorted(options.items()) if not _is_number(value))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _numbers(run: RunRecord) -> dict[Quantity, float]:
    """All numbers that a campaign can change: of the scene, of the options of each method, and each eps."""
    scene = run.scene
    found = {Quantity(item.name, item.unit): item.value for item in scene.parameters if item.value is not None}
    states = [*scene.coordinates, *scene.velocities]
    for what, values in (("start", scene.start), ("goal", scene.goal)):
        found |= {
            Quantity(f"{what} {item.name}", item.unit): value for item, value in zip(states, values, strict=False) if value is not None
        }
    found |= {Quantity("step h", "s"): scene.step, Quantity("steps"): float(scene.steps)}
    for stage in run.stages:
        numbers = {name: float(value) for name, value in stage.options.items() if isinstance(value, (int, float)) and _is_number(value)}
        found |= {Quantity(SEED if name == SEED else f"{stage.method} {spaced(name)}"): value for name, value in numbers.items()}
        if stage.eps:
            found[Quantity(f"ε of stage {stage.index + 1}")] = stage.eps
    return found


def _sweep(report: Report, runs: Sequence[RunRecord], anchor: str) -> Sweep | None:
    """The sweep of runs that differ in a few numbers; along the one with most values, seeds apart."""
    values = [_numbers(run) for run in runs]
    common = [quantity for quantity in values[0] if all(quantity in other for other in values)]
    varied = [quantity for quantity in common if len({numbers[quantity] for numbers in values}) > 1]
    drawn = [quantity for quantity in varied if quantity.name != SEED]
    if not varied or len(drawn) > _MOST:
        return None
    axis = max(drawn, key=lambda quantity: len({numbers[quantity] for numbers in values}), default=Quantity(SEED))
    # What goes with the axis, value for value, is told by it: steps and their length, of one horizon.
    beside = [
        quantity
        for quantity in drawn
        if quantity != axis and len({(numbers[axis], numbers[quantity]) for numbers in values}) > len({numbers[axis] for numbers in values})
    ]
    # An option of many values is swept by pipelines that are named after it; of two, they are two pipelines.
    option = (
        len(drawn) == 1
        and axis.name.partition(" ")[0] in {stage.method for stage in runs[0].stages}
        and len({item[axis] for item in values}) > _PAIR
    )
    several = len({_pipeline(run) for run in runs}) > 1 and not option
    swept = []
    for run, numbers in zip(runs, values, strict=True):
        curve = ", ".join(
            [
                *([_pipeline(run)] if several else []),
                *(f"{quantity.name} = {number(numbers[quantity])} {quantity.unit}".strip() for quantity in beside),
            ]
        )
        seed = next((value for quantity, value in numbers.items() if quantity.name == SEED), None)
        swept.append(
            SweptRun(
                run,
                report.link(run),
                curve or (run.stages[-1].method if option else _pipeline(run)),
                numbers[axis],
                seed if axis.name != SEED else None,
            )
        )
    swept.sort(key=lambda item: (item.curve, item.x))
    if not any(len({(item.x, item.seed) for item in swept if item.curve == curve}) > 1 for curve in {item.curve for item in swept}):
        return None  # other pipelines, not one with other numbers
    styles = styles_of(item.curve for item in swept)
    first = [_plot(axis, swept, styles, *asked) for asked in _asked(swept)]
    names = dict.fromkeys(metric.name for run in runs for metric in run.stages[-1].metrics if metric.name not in (*_FIRST, "cost"))
    others = [_plot(axis, swept, styles, spaced(name), _unit(runs, name), _of(name)) for name in names]
    several_grids = len({(run.scene.step, run.scene.steps) for run in runs}) > 1
    return Sweep(
        f"{axis.name} on {_name([run.scene.name for run in runs], axis)}",
        anchor,
        axis,
        swept,
        keys_of(styles),
        [plot for plot in first if plot is not None],
        [plot for plot in others if plot is not None],
        _conclusion(axis, swept) + (" Grids differ: compare integral costs, not sums over steps." if several_grids else ""),
    )


def _pipeline(run: RunRecord) -> str:
    """The pipeline without the seed that a campaign's file gave it."""
    head, word, tail = run.pipeline.rpartition(f" {SEED} ")
    return head if word and tail.isdigit() else run.pipeline


def _name(names: Sequence[str], axis: Quantity) -> str:
    """What the names of swept scenes begin with: three_cart of three_cart_k_30 and three_cart_k_60."""
    first, last = min(names), max(names)
    shared = next((place for place, pair in enumerate(zip(first, last, strict=False)) if pair[0] != pair[1]), len(first))
    begin = first if first == last else first[:shared].rpartition("_")[0]
    return begin.removesuffix("_" + axis.name.replace(" ", "_")) or first


def _asked(swept: Sequence[SweptRun]) -> list[tuple[str, str, Callable[[RunRecord], float | None]]]:
    """(quantity, unit, value) of the plots that stand first."""
    runs = [item.run for item in swept]
    whole = all(run.integral_cost is None for run in runs)
    price = ("cost", "", attrgetter("cost")) if whole else ("integral cost (cost times h)", "", attrgetter("integral_cost"))
    return [
        price,
        *((spaced(name), _unit(runs, name), _of(name)) for name in _FIRST),
        ("CPU time of solving", "s", attrgetter("solving_cpu")),
    ]


def _of(name: str) -> Callable[[RunRecord], float | None]:
    """The value of a metric of a run's last stage, of the replay that is judged."""

    def value(run: RunRecord) -> float | None:
        metric = run.stages[-1].judged(name)
        return None if metric is None else metric.value

    return value


def _unit(runs: Sequence[RunRecord], name: str) -> str:
    return next((metric.unit for run in runs if (metric := run.stages[-1].metric(name)) is not None), "")


def _plot(
    axis: Quantity, swept: Sequence[SweptRun], styles: Mapping[str, Style], name: str, unit: str, value: Callable[[RunRecord], float | None]
) -> Plot | None:
    """One metric of the runs of a sweep."""
    marks = []
    for item in swept:
        found = value(item.run)
        if found is not None:
            seed = "" if item.seed is None else f", seed {item.seed:g}"
            where = f"{item.run.pipeline} on {item.run.scene.name}: {axis.name} {number(item.x)} {axis.unit}{seed}"
            tip = f"{where}, {name} {number(found, 4)} {unit}, {item.run.verdict}"
            marks.append(Mark(item.curve, item.x, found, tip, item.link, item.run.verdict in HOLD))
    return draw_against(axis, name, unit, marks, styles)


def styles_of(curves: Iterable[str]) -> dict[str, Style]:
    """Colour and marker of each curve."""
    return {curve: (f"c{place % _COLOURS}", _MARKERS[place % len(_MARKERS)]) for place, curve in enumerate(dict.fromkeys(curves))}


def keys_of(styles: Mapping[str, Style]) -> list[Key]:
    """A legend; empty of one curve alone, which the sentences name."""
    return [Key(style, curve, marker) for curve, (style, marker) in styles.items()] if len(styles) > 1 else []


def draw_against(axis: Quantity, name: str, unit: str, marks: Sequence[Mark], styles: Mapping[str, Style]) -> Plot | None:
    """A metric against a swept number: a line through the medians of each curve, a bar over its marks at one place.

    Returns
    -------
    plot : Plot, or None where the metric is the same everywhere, or there are no two places but for seeds
    """
    if len({mark.y for mark in marks}) < 2 or len({mark.x for mark in marks}) < 2:
        return None
    xs, ys = [mark.x for mark in marks], [mark.y for mark in marks]
    plot = Plot(
        f"{capital(name)} against {axis.name}",
        Axis.fitted(axis.name, axis.unit, xs, log=is_wide(xs) and axis.name != SEED, margin=0.06),
        Axis.fitted(name, unit, ys, log=is_wide(ys), margin=0.08),
    )
    said = []
    for curve, (style, _) in styles.items():
        mine: dict[float, list[float]] = {}
        for mark in marks:
            if mark.curve == curve:
                mine.setdefault(mark.x, []).append(mark.y)
        for x, values in mine.items():
            if len(values) > 1:
                plot.line(f"{curve}, spread", f"{style} soft", [x, x], [min(values), max(values)])
        if axis.name != SEED and mine:
            plot.line(curve, style, sorted(mine), [median(mine[x]) for x in sorted(mine)])
        if mine:
            ends = [median(mine[x]) for x in (min(mine), max(mine))]
            said.append(f"{curve}: {number(ends[0], 3)} to {number(ends[1], 3)} {unit}".strip())
    for mark in marks:
        style, marker = styles[mark.curve]
        plot.point(mark.x, mark.y, f"{style} full" if mark.holds else style, marker, mark.tip, mark.link)
    plot.words = f"{'; '.join(said)}. Filled: the plan holds."
    return plot


def _conclusion(axis: Quantity, swept: Sequence[SweptRun]) -> str:
    """At which values plans hold."""
    if axis.name == SEED:
        held = sum(item.run.verdict in HOLD for item in swept)
        return f"{held} of {count(len(swept), SEED)} {'holds' if held == 1 else 'hold'}."
    said = []
    for curve in dict.fromkeys(item.curve for item in swept):
        at: dict[float, list[bool]] = {}
        for item in swept:
            if item.curve == curve:
                at.setdefault(item.x, []).append(item.run.verdict in HOLD)
        told = [_at(x, axis.unit, held) for x, held in at.items() if any(held)]
        said.append(f"{curve} holds at {axis.name} = {listing(told)}" if told else f"{curve} holds at no value of {axis.name}")
    return f"{'; '.join(said)}."


def _at(x: float, unit: str, held: Sequence[bool]) -> str:
    """`0.1 rad (2 of 3 seeds)`."""
    return f"{number(x)} {unit}".strip() + ("" if len(held) == 1 else f" ({sum(held)} of {len(held)} seeds)")
