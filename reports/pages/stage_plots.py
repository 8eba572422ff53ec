"""The plots of one stage: planned against replayed, phases of contact, error over time, iteration history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.judged import is_tracked, judged_trace
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import QuantityRecord, SceneRecord, StageRecord, TraceRecord
from reports.traces import column, contact_phases, force, gap, position_error
from reports.wording import clean, error, number

_KEYS = [
    Key("plan", "plan"),
    Key("replay", "replay"),
    Key("touch", "replay in contact", "swatch"),
    Key("planned-touch", "plan in contact", "swatch"),
]
# More panels of history than this tell nothing more.
_MOST_HISTORY = 8
_MOST_COLOURS = 6
# Ipopt's own column names say little to those who do not know them.
_HISTORY_WORDS = {
    "inf_pr": "primal infeasibility",
    "inf_du": "dual infeasibility",
    "mu": "barrier parameter µ",
    "d_norm": "size of the step",
    "alpha_pr": "primal step length",
    "alpha_du": "dual step length",
    "regularization_size": "regularisation",
}


@dataclass(frozen=True)
class StagePlots:
    """`absent`: for each thing that cannot be drawn, the reason."""

    keys: list[Key]
    motion: list[Plot]
    history: list[Plot]
    absent: list[str]


def is_empty(stage: StageRecord) -> bool:
    """Whether it left nothing to draw or to score: the reason stands in its sentence."""
    return not (stage.metrics or stage.replay or any(trace and trace.t for trace in (stage.plan_trace, stage.replay_trace)))


def stage_plots(scene: SceneRecord, stage: StageRecord) -> StagePlots:
    plan = stage.plan_trace if stage.plan_trace is not None and stage.plan_trace.t else None
    replay = judged_trace(stage)
    absent = []
    if is_empty(stage):
        absent.append("There is no plan, so nothing is drawn, replayed or scored.")
    elif plan is None:
        absent.append("No planned trajectory is stored.")
    if replay is None and not is_empty(stage):
        said = stage.replay.message if stage.replay is not None and stage.replay.message else ""
        absent.append("No replay is stored: " + (said or ("there is no plan to replay." if plan is None else "the plan was not replayed.")))
    if not stage.history and not is_empty(stage):
        absent.append("The method kept no history of its iterations.")
    motion: list[Plot | None] = []
    times = [t for trace in (plan, replay) if trace is not None for t in (trace.t[0], trace.t[-1])]
    if times:
        x = Axis.fitted("time", "s", times, margin=0.0)
        for unit in dict.fromkeys(item.unit for item in scene.coordinates):
            motion.append(_positions([item for item in scene.coordinates if item.unit == unit], unit, x, plan, replay))
        for contact in scene.contacts:
            motion.append(_contact(scene, f"Contact force, {contact.name}", "force", "N", contact.name, x, plan, replay))
        for friction in scene.frictions:
            motion.append(
                _contact(scene, f"Friction force, {friction.description or friction.name}", "force", "N", friction.name, x, plan, replay)
            )
        opened = stage.replay_trace if stage.replay_trace is not None and stage.replay_trace.t else None
        tracked = stage.tracked_trace if stage.tracked_trace is not None and stage.tracked_trace.t else None
        motion.append(_error(scene, x, plan, opened) if tracked is None else _two_errors(scene, x, plan, opened, tracked))
        for contact in scene.contacts:
            motion.append(_contact(scene, f"Gap, {contact.name}", "gap", "m", contact.name, x, plan, replay))
        motion.append(_inputs(scene, x, plan, tracked))
    history = [_history(name, values, stage.iterations) for name, values in list(stage.history.items())[:_MOST_HISTORY] if len(values) > 1]
    keys = [*_KEYS[:1], Key("replay", "replay with feedback"), *_KEYS[2:]] if is_tracked(stage) else _KEYS
    return StagePlots(keys, [plot for plot in motion if plot is not None], history, absent)


def _positions(items: list[QuantityRecord], unit: str, x: Axis, plan: TraceRecord | None, replay: TraceRecord | None) -> Plot | None:
    data = [
        (item, f"c{place % _MOST_COLOURS} {style}", name, trace, values)
        for place, item in enumerate(items)
        for name, style, trace in (("replay", "", replay), ("plan", "ghost", plan))
        if trace is not None and (values := column(trace, item.name))
    ]
    if not data:
        return None
    plot = Plot(
        "Positions: plan dotted, replay solid",
        x,
        Axis.fitted("position", unit, np.concatenate([values for *_, values in data]), margin=0.1),
    )
    for item, style, name, trace, values in data:
        plot.line(f"{item.name} {name}", style, trace.t, values)
    for item in items:
        mine = [entry for entry in data if entry[0] is item]
        if mine:
            plot.label(x.low, mine[0][4][0], item.name, f"strong {mine[0][1].split()[0]}")
    ends = [
        (name, ", ".join(f"{item.name} {number(values[-1], 5)}" for item, _, other, _, values in data if other == name))
        for name in ("plan", "replay")
    ]
    plot.words = " ".join(f"The {name} ends at {words} {unit}." for name, words in ends if words)
    return plot


def _contact(
    scene: SceneRecord, title: str, quantity: str, unit: str, contact: str, x: Axis, plan: TraceRecord | None, replay: TraceRecord | None
) -> Plot | None:
    read = force if quantity == "force" else gap
    data = [
        (name, trace, values)
        for name, trace in (("replay", replay), ("plan", plan))
        if trace is not None and (values := read(trace, contact))
    ]
    if not data:
        return None
    plot = Plot(title, x, Axis.fitted(quantity, unit, np.concatenate([values for *_, values in data]), zero=True))
    phases, planned = contact_phases(replay, contact), contact_phases(plan, contact)
    for low, high in phases:
        plot.band(low, high, "touch")
    for low, high in planned:
        plot.strip(low, high, "planned-touch", 0)
    for name, trace, values in data:
        plot.line(name, name, trace.t, values)
    rubs = any(friction.name == contact for friction in scene.frictions)
    size = (lambda values: max(map(abs, values))) if rubs else max  # friction acts in two directions
    told = [f"Largest{' size' if rubs else ''} in the {name}: {number(size(values), 3)} {unit}." for name, _, values in data]
    if replay is not None:
        windows = [f"{number(low, 3)} to {number(high, 3)} s" for low, high in phases[:4]]
        told.append(
            f"{'Friction acts' if rubs else 'In contact'} in the replay: {', '.join(windows) or 'never'}{' and more' if len(phases) > 4 else ''}."
        )
    plot.words = " ".join(told)
    return plot


def _error(scene: SceneRecord, x: Axis, plan: TraceRecord | None, replay: TraceRecord | None) -> Plot | None:
    found = position_error(scene, plan, replay)
    if found is None:
        return None
    times, values = found
    unit = "/".join(dict.fromkeys(item.unit for item in scene.coordinates))
    plot = Plot("Position error: replay against plan", x, Axis.fitted("largest difference", unit, np.asarray(values), zero=True))
    plot.line("difference", "c5", times, values)
    worst = int(np.argmax(values))
    plot.words = f"The largest difference is {error(values[worst])} {unit}, at {number(times[worst], 3)} s; at the end it is {error(values[-1])} {unit}."
    return plot


def _two_errors(scene: SceneRecord, x: Axis, plan: TraceRecord | None, opened: TraceRecord | None, tracked: TraceRecord) -> Plot | None:
    """Inputs alone and with feedback on one logarithmic axis: what grows, and what feedback leaves of it."""
    found = [
        (name, style, position_error(scene, plan, trace))
        for name, style, trace in (("inputs alone", "c3", opened), ("with feedback", "c5", tracked))
    ]
    lines = [(name, style, *values) for name, style, values in found if values is not None]
    positive = [value for *_, values in lines for value in values if value > 0.0]
    if not positive:
        return None
    unit = "/".join(dict.fromkeys(item.unit for item in scene.coordinates))
    # The start is exact: below a millionth of the largest nothing needs to be read.
    floor = max(min(positive), 1e-6 * max(positive))
    plot = Plot(
        "Position error: inputs alone and with feedback",
        x,
        Axis.fitted("largest difference", unit, [max(value, floor) for value in positive], log=True),
    )
    for name, style, times, values in lines:
        plot.line(name, style, times, [max(value, floor) for value in values])
        place = 3 * len(times) // 4  # far from the start, which they share, and from the edge
        plot.label(times[place], max(values[place], floor), name, f"strong {style}")
    plot.words = " ".join(
        f"{name.capitalize()}: at most {error(max(values))} {unit}, at the end {error(values[-1])} {unit}." for name, _, _, values in lines
    )
    return plot


def _inputs(scene: SceneRecord, x: Axis, plan: TraceRecord | None, tracked: TraceRecord | None) -> Plot | None:
    if plan is None:
        return None
    data = [(item, values) for item in scene.inputs if (values := column(plan, item.name))]
    if not data:
        return None
    units = list(dict.fromkeys(item.unit for item, _ in data))
    applied = {item.name: values for item, _ in data if (values := column(tracked, item.name))}
    title = "Inputs of the plan (dotted) and with feedback" if applied else "Inputs of the plan"
    every = np.concatenate([*(values for _, values in data), *applied.values()])
    plot = Plot(title, x, Axis.fitted("input", "/".join(units), every, zero=True))
    for place, (item, values) in enumerate(data):
        style = f"c{place % _MOST_COLOURS}"
        if tracked is not None and item.name in applied:
            plot.line(f"{item.name} with feedback", style, tracked.t, applied[item.name])
            style += " ghost"
        plot.line(item.name, style, plan.t, values)
        peak = int(np.abs(values).argmax())
        plot.label(plan.t[min(peak, len(plan.t) - 1)], values[peak], item.name, f"strong c{place % _MOST_COLOURS}")
    plot.words = " ".join(
        f"{item.name} lies between {number(min(values), 3)} and {number(max(values), 3)} {item.unit}." for item, values in data
    )
    return plot


def _history(name: str, values: Sequence[float], iterations: int) -> Plot:
    """One column of the iteration history, over all iterations if it was thinned; logarithmic where it is positive and spans two powers of ten."""
    name = _HISTORY_WORDS.get(name, clean(name).replace("_", " "))
    stride = max(1.0, iterations / (len(values) - 1))
    positive = [value for value in values if value > 0]
    log = len(positive) > 1 and min(values) >= 0 and max(positive) / min(positive) > 100
    plot = Plot(
        name,
        Axis.fitted("iteration", "", [0, stride * (len(values) - 1)], margin=0.0),
        Axis.fitted(name, "", values, log=log),
        width=340,
        height=180,
    )
    shown = [(place, value) for place, value in enumerate(values) if value > 0 or not log]
    plot.line(name, "c0", [place * stride for place, _ in shown], [value for _, value in shown])
    plot.words = f"From {number(values[0], 3)} to {number(values[-1], 3)}."
    return plot
