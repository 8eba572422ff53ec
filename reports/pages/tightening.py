"""Figs. 4-6 of the paper: how the plans of a relaxation change while eps is tightened."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from reports.pages.section import Report, Section
from reports.paper import TIGHTENING_FIGURES
from reports.plots.axis import Axis
from reports.plots.figure import Drawing, Key, Plot
from reports.records.record import QuantityRecord, SceneRecord, TraceRecord
from reports.rows import Row
from reports.traces import column, force, gap
from reports.wording import error, number, small

# Classes s0 (loosest) .. s5 (tightest) of the page's sequential colours.
_SHADES = 6


@dataclass(frozen=True)
class Sweep:
    """The stages of one relaxation on one scene, loosest eps first, and their plots."""

    scene: str
    title: str
    anchor: str
    rows: list[Row]
    keys: list[Key]
    plots: list[Drawing]
    absent: str


@dataclass(frozen=True)
class _Drawn:
    """What the traces of a sweep show; there: of which rows a plan is stored."""

    there: list[bool]
    plots: list[dict[str, Any]]


def build(report: Report) -> Section | None:
    sweeps: list[Sweep] = []
    for scene in report.scenes:
        rows = [row for row in report.rows_of_scene(scene) if row.stage.kind == "indirect" and row.stage.eps and len(row.methods) == 1]
        # One sweep a method and pipeline: the same method with other options is another sweep, and not the paper's figure.
        groups: dict[tuple[str, str, str], list[Row]] = {}
        for row in rows:
            figure = TIGHTENING_FIGURES.get(row.stage.method, "") if row.stage.paper else ""
            groups.setdefault((figure or "z", row.stage.method, "" if figure else row.run.pipeline), []).append(row)
        for (figure, _, pipeline), mine in sorted(groups.items(), key=lambda item: item[0]):
            if len(mine) > 1:
                ordered = sorted(mine, key=lambda row: -(row.stage.eps or 0.0))
                sweeps.append(_sweep(report, scene, figure.rstrip("z"), pipeline, ordered, len(sweeps) + 1))
    if not sweeps:
        return None
    scenes = [(name, [sweep for sweep in sweeps if sweep.scene == name]) for name in dict.fromkeys(sweep.scene for sweep in sweeps)]
    # The contents lead to the first sweep of each scene, where there are several scenes.
    entries = [(mine[0].anchor, name) for name, mine in scenes] if len(scenes) > 1 else [(sweep.anchor, sweep.title) for sweep in sweeps]
    return Section("tightening", "Figs. 4–6: plans while ε is tightened", "tightening.html", {"scenes": scenes}, tuple(entries))


def _sweep(report: Report, scene: SceneRecord, figure: str, pipeline: str, rows: list[Row], place: int) -> Sweep:
    stages = [str(len(row.chain)) for row in rows]
    drawn = _Drawn(**json.loads(report.kept(lambda: _drawn(report, rows), (row.run for row in rows), "tightening", *stages)))
    title = (f"{figure}: " if figure else "") + rows[0].stage.method_title + (f" ({pipeline})" if pipeline else "")
    missing = [f"ε = {small(row.stage.eps)}" for row, there in zip(rows, drawn.there, strict=True) if not there]
    return Sweep(
        scene=scene.name,
        title=f"{title} on {scene.name}" if len(report.scenes) > 1 else title,
        anchor=f"tightening-{place}",
        rows=rows,
        keys=[Key(f"s{_shade(index, len(rows))}", f"ε = {small(row.stage.eps)}") for index, row in enumerate(rows) if drawn.there[index]],
        plots=[Drawing(**plot) for plot in drawn.plots],
        absent=f"No plan is stored for {', '.join(missing)}." if missing else "",
    )


def _drawn(report: Report, rows: list[Row]) -> str:
    """JSON of what a sweep's traces show."""
    traces = [_plan(report, row) for row in rows]
    lines = [
        (f"ε = {small(row.stage.eps)}", f"s{_shade(index, len(rows))}", trace)
        for index, (row, trace) in enumerate(zip(rows, traces, strict=True))
        if trace is not None
    ]
    plots = [asdict(plot.drawing()) for plot in _plots(rows[0].run.scene, lines) if plot is not None]
    return json.dumps({"there": [trace is not None for trace in traces], "plots": plots}, ensure_ascii=False)


def _plan(report: Report, row: Row) -> TraceRecord | None:
    trace = report.whole(row.run).stages[len(row.chain) - 1].plan_trace
    return trace if trace is not None and trace.t else None


def _shade(index: int, amount: int) -> int:
    return round(index * (_SHADES - 1) / max(1, amount - 1))


def _plots(scene: SceneRecord, lines: list[tuple[str, str, TraceRecord]]) -> list[Plot | None]:
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


def _positions(items: Sequence[QuantityRecord], unit: str, lines: list[tuple[str, str, TraceRecord]]) -> Plot | None:
    data = [(item, words, style, trace, values) for item in items for words, style, trace in lines if (values := column(trace, item.name))]
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


def _single(title: str, quantity: str, unit: str, data: list[tuple[str, str, TraceRecord, Sequence[float] | None]]) -> Plot | None:
    usable = [(words, style, trace, values) for words, style, trace, values in data if values]
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
