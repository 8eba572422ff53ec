"""Figs. 4-6 of the paper: how the plans of a relaxation on a scene change while eps is tightened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.pages.section import Report, Section
from reports.paper import TIGHTENING_FIGURES
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import QuantityRecord, SceneRecord
from reports.rows import Row
from reports.traces import Array, Trace, column, force, gap
from reports.wording import error, number, small

# Classes s0 (loosest) .. s5 (tightest) of the page's sequential colours.
_SHADES = 6


@dataclass(frozen=True)
class Sweep:
    """The stages of one relaxation on one scene, loosest eps first, and their plots."""

    title: str
    anchor: str
    rows: list[Row]
    keys: list[Key]
    plots: list[Plot]
    absent: str


def build(report: Report, scene: SceneRecord) -> Section | None:
    """The sweeps of one scene; None where no method on it has more than one eps."""
    rows = [row for row in report.rows_of_scene(scene) if row.stage.kind == "indirect" and row.stage.eps and len(row.methods) == 1]
    # One sweep a method and pipeline: the same method with other options is another sweep, and not the paper's figure.
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        figure = TIGHTENING_FIGURES.get(row.stage.method, "") if row.stage.paper else ""
        groups.setdefault((figure or "z", row.stage.method, "" if figure else row.run.pipeline), []).append(row)
    sweeps: list[Sweep] = []
    place = report.scenes.index(scene) + 1
    for (figure, _, pipeline), mine in sorted(groups.items(), key=lambda item: item[0]):
        if len(mine) > 1:
            ordered = sorted(mine, key=lambda row: -(row.stage.eps or 0.0))
            sweeps.append(_sweep(report, scene, figure.rstrip("z"), pipeline, ordered, f"tightening-{place}-{len(sweeps) + 1}"))
    if not sweeps:
        return None
    figures = "Figs. 4–6: plans" if any(sweep.title.startswith("Fig.") for sweep in sweeps) else "Plans"
    entries = tuple((sweep.anchor, sweep.title) for sweep in sweeps)
    return Section(f"tightening-{place}", f"{figures} while ε is tightened", "tightening.html", {"sweeps": sweeps}, entries)


def _sweep(report: Report, scene: SceneRecord, figure: str, pipeline: str, rows: list[Row], anchor: str) -> Sweep:
    lines, missing = [], []
    for index, row in enumerate(rows):
        plan = report.plan(row.run, row.stage)
        words = f"ε = {small(row.stage.eps)}"
        if plan is None:
            missing.append(words)
        else:
            lines.append((words, f"s{round(index * (_SHADES - 1) / max(1, len(rows) - 1))}", plan))
    return Sweep(
        title=(f"{figure}: " if figure else "") + rows[0].stage.method_title + (f" ({pipeline})" if pipeline else ""),
        anchor=anchor,
        rows=rows,
        keys=[Key(style, words) for words, style, _ in lines],
        plots=[plot for plot in _plots(scene, lines) if plot is not None],
        absent=f"No plan is stored for {', '.join(missing)}." if missing else "",
    )


def _plots(scene: SceneRecord, lines: list[tuple[str, str, Trace]]) -> list[Plot | None]:
    units = list(dict.fromkeys(item.unit for item in scene.coordinates))
    positions = [_positions([item for item in scene.coordinates if item.unit == unit], unit, lines) for unit in units]
    forces = [
        _single(f"Contact force, {item.name}", "force", "N", [(*line, force(line[2], item.name)) for line in lines])
        for item in scene.contacts
    ]
    gaps = [_single(f"Gap, {item.name}", "gap", "m", [(*line, gap(line[2], item.name)) for line in lines]) for item in scene.contacts]
    inputs = [
        _single(f"Input {item.name}", item.name, item.unit, [(*line, column(line[2], item.name)) for line in lines])
        for item in scene.inputs
    ]
    return [*positions, *forces, *gaps, *inputs]


def _positions(items: Sequence[QuantityRecord], unit: str, lines: list[tuple[str, str, Trace]]) -> Plot | None:
    data = [
        (item, words, style, trace, values)
        for item in items
        for words, style, trace in lines
        if (values := column(trace, item.name)) is not None
    ]
    if not data:
        return None
    plot = Plot(
        "Positions",
        Axis.fitted("time", "s", [t for _, _, trace in lines for t in (trace.t[0], trace.t[-1])], margin=0.0),
        Axis.fitted("position", unit, np.concatenate([values for *_, values in data]), margin=0.08),
        height=300,
    )
    for item, words, style, trace, values in data:
        plot.line(f"{item.name}, {words}", style, trace.t, values)
    for item in items:
        mine = [entry for entry in data if entry[0] is item]
        if mine:
            plot.label(mine[-1][3].t[0], mine[-1][4][0], item.name, "strong")
    plot.words = " ".join(
        f"{item.name} {words}: from {error(values[0])} to {number(values[-1], 3)} {unit}."
        for item, words, _, _, values in data
        if words == data[-1][1]
    )
    return plot


def _single(title: str, quantity: str, unit: str, data: list[tuple[str, str, Trace, Array | None]]) -> Plot | None:
    usable = [(words, style, trace, values) for words, style, trace, values in data if values is not None]
    if not usable:
        return None
    plot = Plot(
        title,
        Axis.fitted("time", "s", [t for _, _, trace, _ in usable for t in (trace.t[0], trace.t[-1])], margin=0.0),
        Axis.fitted(quantity, unit, np.concatenate([values for *_, values in usable]), zero=True),
    )
    for words, style, trace, values in usable:
        plot.line(words, style, trace.t, values)
    told = []
    for words, style, trace, values in usable:
        peak = int(np.abs(values).argmax())
        told.append(f"{words}: largest size {number(abs(values[peak]), 3)} {unit} at {number(trace.t[min(peak, len(trace.t) - 1)], 3)} s.")
        if quantity == "force":
            plot.label(trace.t[min(peak, len(trace.t) - 1)], values[peak], words, style, anchor="middle")
    plot.words = " ".join(told)
    return plot
