"""Plots of one stage: plan and replay, contact phases, errors, iteration history."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.results.run import QuantityRecord, SceneRecord, StageRecord
from reports.plots import Axis, Key, Plot, over_time
from reports.traces import Motion, Trace, contact_phases
from reports.wording import ROUNDING, clean, error, number, with_unit

_KEYS = [
    Key("plan", "plan"),
    Key("replay", "replay"),
    Key("touch", "replay in contact", "swatch"),
    Key("planned-touch", "plan in contact", "swatch"),
]
# Largest number of histories.
_MOST_HISTORY = 8
# Number of colours of curves.
_MOST_COLOURS = 6
# Descriptions of Ipopt's column names.
_HISTORY_WORDS = {
    "inf_pr": "primal infeasibility",
    "inf_du": "dual infeasibility",
    "mu": "barrier parameter µ",
    "d_norm": "size of the step",
    "alpha_pr": "primal step length",
    "alpha_du": "dual step length",
    "regularization_size": "regularisation",
}


class StagePlots(NamedTuple):
    """The plots of a stage, and reasons for absent ones."""

    keys: list[Key]
    motion: list[Plot]
    history: list[Plot]
    absent: list[str]


def stage_plots(
    scene: SceneRecord, stage: StageRecord, motion: Motion, *, whole: bool = True
) -> StagePlots:
    """Return the plots of a stage; whole: include friction, gaps, inputs and history."""
    plan, replay = motion.plan, motion.judged(stage)
    absent = list(motion.problems)
    if stage.is_empty:
        absent.append("There is no plan, so nothing is drawn, replayed or scored.")
    elif plan is None:
        absent.append("No planned trajectory is stored.")
    if replay is None and not stage.is_empty:
        message = stage.replay.message if stage.replay is not None and stage.replay.message else ""
        absent.append(
            "No replay is stored: "
            + (
                message
                or ("there is no plan to replay." if plan is None else "the plan was not replayed.")
            )
        )
    if not stage.history and not stage.is_empty and stage.kind != "given":
        absent.append("The method kept no history of its iterations.")
    plots: list[Plot | None] = []
    times = [t for trace in (plan, replay) if trace is not None for t in (trace.t[0], trace.t[-1])]
    if times:
        x = Axis.fitted("time", "s", times, margin=0.0)
        for unit in dict.fromkeys(item.unit for item in scene.coordinates):
            plots.append(
                _positions(
                    [item for item in scene.coordinates if item.unit == unit], unit, x, plan, replay
                )
            )
        for contact in scene.contacts:
            plots.append(
                _contact(
                    scene,
                    f"Contact force, {contact.name}",
                    "force",
                    "N",
                    contact.name,
                    x,
                    plan,
                    replay,
                )
            )
        for friction in scene.frictions if whole else ():
            title = f"Friction force, {friction.description or friction.name}"
            plots.append(_contact(scene, title, "force", "N", friction.name, x, plan, replay))
        plots.append(
            _error(scene, x, motion.replay)
            if motion.tracked is None
            else _two_errors(scene, x, motion.replay, motion.tracked)
        )
        for contact in scene.contacts if whole else ():
            plots.append(
                _contact(scene, f"Gap, {contact.name}", "gap", "m", contact.name, x, plan, replay)
            )
        if whole:
            plots.append(_inputs(scene, x, plan, motion.tracked))
    kept = list(stage.history.items())[:_MOST_HISTORY] if whole else []
    history = [_history(name, values, stage.iterations) for name, values in kept if len(values) > 1]
    keys = (
        [*_KEYS[:1], Key("replay", "replay with feedback"), *_KEYS[2:]]
        if stage.is_tracked
        else _KEYS
    )
    return StagePlots(keys, [plot for plot in plots if plot is not None], history, absent)


def _positions(
    items: list[QuantityRecord], unit: str, x: Axis, plan: Trace | None, replay: Trace | None
) -> Plot | None:
    data = [
        (item, name, (f"{item.name} {name}", f"c{place % _MOST_COLOURS} {style}", trace.t, values))
        for place, item in enumerate(items)
        for name, style, trace in (("replay", "", replay), ("plan", "ghost", plan))
        if trace is not None and (values := trace.columns.get(item.name)) is not None
    ]
    plot = over_time(
        "Positions: plan dotted, replay solid",
        "position",
        unit,
        [line for *_, line in data],
        x=x,
        margin=0.1,
    )
    if plot is None:
        return None
    for item in items:
        mine = [line for other, _, line in data if other is item]
        if mine:
            plot.label(x.low, mine[0][3][0], item.name, f"strong {mine[0][1].split()[0]}")
    ends = {"plan": [], "replay": []}
    for item, name, line in data:
        last = float(line[3][-1])
        ends[name].append(
            f"{item.name} {number(0.0 if abs(last) < ROUNDING else last, 5)}"
        )  # rounding is shown as 0
    plot.words = " ".join(
        f"The {name} ends at {with_unit(', '.join(words), unit)}."
        for name, words in ends.items()
        if words
    )
    return plot


def _contact(
    scene: SceneRecord,
    title: str,
    quantity: str,
    unit: str,
    contact: str,
    x: Axis,
    plan: Trace | None,
    replay: Trace | None,
) -> Plot | None:
    read = Trace.force if quantity == "force" else Trace.gap
    lines = [
        (name, name, trace.t, values)
        for name, trace in (("replay", replay), ("plan", plan))
        if trace is not None and (values := read(trace, contact)) is not None
    ]
    plot = over_time(title, quantity, unit, lines, x=x, zero=True)
    if plot is None:
        return None
    phases, planned = contact_phases(replay, contact), contact_phases(plan, contact)
    for low, high in phases:
        plot.band(low, high, "touch")
    for low, high in planned:
        plot.strip(low, high, "planned-touch")
    rubs = any(friction.name == contact for friction in scene.frictions)
    size = (
        (lambda values: np.abs(values).max()) if rubs else np.max
    )  # friction acts in two directions
    sentences = [
        f"Largest{' size' if rubs else ''} in the {name}: {number(size(values), 3)} {unit}."
        for name, *_, values in lines
    ]
    if replay is not None:
        windows = (
            ", ".join(f"{number(low, 3)} to {number(high, 3)} s" for low, high in phases[:4])
            or "never"
        )
        sentences.append(
            f"{'Friction acts' if rubs else 'In contact'} in the replay: {windows}{' and more' if len(phases) > 4 else ''}."
        )
    plot.words = " ".join(sentences)
    return plot


def _error(scene: SceneRecord, x: Axis, replay: Trace | None) -> Plot | None:
    values = replay and replay.columns.get("position_error")
    if replay is None or values is None:
        return None
    unit = "/".join(dict.fromkeys(item.unit for item in scene.coordinates))
    line = ("difference", "c5", replay.t, values)
    plot = over_time(
        "Position error: replay against plan", "largest difference", unit, [line], x=x, zero=True
    )
    assert plot is not None
    worst = int(np.argmax(values))
    plot.words = f"The largest difference is {error(values[worst])} {unit}, at {number(replay.t[worst], 3)} s; at the end it is {error(values[-1])} {unit}."
    return plot


def _two_errors(scene: SceneRecord, x: Axis, opened: Trace | None, tracked: Trace) -> Plot | None:
    lines = [
        (name, style, trace.t, values)
        for name, style, trace in (("inputs alone", "c3", opened), ("with feedback", "c5", tracked))
        if trace is not None and (values := trace.columns.get("position_error")) is not None
    ]
    positive = (
        np.concatenate([values[values > 0.0] for *_, values in lines]) if lines else np.zeros(0)
    )
    if not len(positive):
        return None
    unit = "/".join(dict.fromkeys(item.unit for item in scene.coordinates))
    # The start is exact: values below a millionth of the largest are clipped.
    floor = max(positive.min(), 1e-6 * positive.max())
    shown = [
        (name, style, times, np.maximum(values, floor)) for name, style, times, values in lines
    ]
    plot = over_time(
        "Position error: inputs alone and with feedback",
        "largest difference",
        unit,
        shown,
        x=x,
        log=True,
    )
    assert plot is not None
    for name, style, times, values in shown:
        place = 3 * len(times) // 4  # far from the common start, and from the edge
        plot.label(times[place], values[place], name, f"strong {style}")
    sentences = [
        f"{name.capitalize()}: at most {error(values.max())} {unit}, at the end {error(values[-1])} {unit}."
        for name, *_, values in lines
    ]
    plot.words = " ".join(sentences)
    return plot


def _inputs(scene: SceneRecord, x: Axis, plan: Trace | None, tracked: Trace | None) -> Plot | None:
    if plan is None:
        return None
    data = [
        (item, values)
        for item in scene.inputs
        if (values := plan.columns.get(item.name)) is not None
    ]
    if not data:
        return None
    units = list(dict.fromkeys(item.unit for item, _ in data))
    applied = (
        {}
        if tracked is None
        else {
            item.name: tracked.columns[item.name]
            for item, _ in data
            if item.name in tracked.columns
        }
    )
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
        plot.label(
            plan.t[min(peak, len(plan.t) - 1)],
            values[peak],
            item.name,
            f"strong c{place % _MOST_COLOURS}",
        )
    ranges = [(item, number(values.min(), 3), number(values.max(), 3)) for item, values in data]
    plot.words = " ".join(
        f"{item.name} lies between {low} and {with_unit(high, item.unit)}."
        for item, low, high in ranges
    )
    return plot


def _history(name: str, values: tuple[float, ...], iterations: int) -> Plot:
    """Return a column of the iteration history, logarithmic if it spans two powers of ten."""
    name = _HISTORY_WORDS.get(name, clean(name).replace("_", " "))
    stride = max(1.0, iterations / (len(values) - 1))
    positive = [value for value in values if value > 0]
    log = len(positive) > 1 and min(values) >= 0 and max(positive) / min(positive) > 100
    x = Axis.fitted("iteration", "", [0, stride * (len(values) - 1)], margin=0.0)
    plot = Plot(name, x, Axis.fitted(name, "", values, log=log), width=340, height=180)
    shown = [(place, value) for place, value in enumerate(values) if value > 0 or not log]
    plot.line(name, "c0", [place * stride for place, _ in shown], [value for _, value in shown])
    # Enough digits to differ.
    digits = next(
        (digits for digits in (3, 5) if number(values[0], digits) != number(values[-1], digits)), 7
    )
    plot.words = f"From {number(values[0], digits)} to {number(values[-1], digits)}."
    return plot
