"""Figs. 4-6 of the paper: how the plans of a relaxation on a scene change while eps is tightened, and how the metrics go with eps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reports.pages.section import Report, Section
from reports.pages.sweeps import Mark, Quantity, draw_against, keys_of, styles_of
from reports.paper import TIGHTENING_FIGURES
from reports.plots import Key, Plot, over_time
from reports.records.record import QuantityRecord, SceneRecord
from reports.rows import Row
from reports.traces import Array, Trace, column, force, gap
from reports.wording import error, number, small, spaced

# Metrics that are drawn against eps.
_AGAINST = ("replay_terminal_position_error", "replay_terminal_velocity_error", "replay_error", "physics_scaled", "cost")
# Classes s0 (loosest) .. s5 (tightest) of the page's sequential colours.
_SHADES = 6


@dataclass(frozen=True)
class TighteningCurve:
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
    sweeps: list[TighteningCurve] = []
    place = report.scenes.index(scene) + 1
    for (figure, _, pipeline), mine in sorted(groups.items(), key=lambda item: item[0]):
        if len(mine) > 1:
            ordered = sorted(mine, key=lambda row: -(row.stage.eps or 0.0))
            sweeps.append(_sweep(report, scene, figure.rstrip("z"), pipeline, ordered, f"tightening-{place}-{len(sweeps) + 1}"))
    if not sweeps:
        return None
    figures = "Figs. 4–6: plans" if any(sweep.title.startswith("Fig.") for sweep in sweeps) else "Plans"
    entries = tuple((sweep.anchor, sweep.title) for sweep in sweeps)
    styles = styles_of(_curve(sweep) for sweep in sweeps)
    against = [plot for name in _AGAINST if (plot := _against(name, sweeps, styles)) is not None]
    values = {"sweeps": sweeps, "keys": keys_of(styles), "against": against}
    return Section(f"tightening-{place}", f"{figures} while ε is tightened", "scene.html#tightening", values, entries)


def _curve(sweep: TighteningCurve) -> str:
    return sweep.title.partition(": ")[2] if sweep.title.startswith("Fig. ") else sweep.title


def _against(name: str, sweeps: Sequence[TighteningCurve], styles: Mapping[str, tuple[str, str]]) -> Plot | None:
    """One metric of all relaxations against eps."""
    marks, unit = [], ""
    for sweep in sweeps:
        for row in sweep.rows:
            metric, eps = row.stage.judged(name), row.stage.eps
            if metric is not None and metric.value is not None and eps:
                unit = metric.unit
                tip = f"{row.label}: {spaced(name)} {number(metric.value, 3)} {unit}, {row.stage.verdict}"
                marks.append(Mark(_curve(sweep), eps, metric.value, tip, row.link, row.holds))
    return draw_against(Quantity("ε"), spaced(name), unit, marks, styles)


def _sweep(report: Report, scene: SceneRecord, figure: str, pipeline: str, rows: list[Row], anchor: str) -> TighteningCurve:
    lines, missing = [], []
    for index, row in enumerate(rows):
        plan = report.plan(row.run, row.stage)
        words = f"ε = {small(row.stage.eps)}"
        if plan is None:
            missing.append(words)
        else:
            lines.append((words, f"s{round(index * (_SHADES - 1) / max(1, len(rows) - 1))}", plan))
    return TighteningCurve(
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
        (item, words, (f"{item.name}, {words}", style, trace.t, values))
        for item in items
        for words, style, trace in lines
        if (values := column(trace, item.name)) is not None
    ]
    plot = over_time("Positions", "position", unit, [line for *_, line in data], height=300, margin=0.08)
    if plot is None:
        return None
    for item in items:
        mine = [line for other, _, line in data if other is item]
        if mine:
            plot.label(mine[-1][2][0], mine[-1][3][0], item.name, "strong")
    plot.words = " ".join(
        f"{item.name} {words}: from {error(values[0])} to {number(values[-1], 3)} {unit}."
        for item, words, (*_, values) in data
        if words == data[-1][1]
    )
    return plot


def _single(title: str, quantity: str, unit: str, data: list[tuple[str, str, Trace, Array | None]]) -> Plot | None:
    lines = [(words, style, trace.t, values) for words, style, trace, values in data if values is not None]
    plot = over_time(title, quantity, unit, lines, zero=True)
    if plot is None:
        return None
    told = []
    for words, style, times, values in lines:
        peak = int(np.abs(values).argmax())
        when = times[min(peak, len(times) - 1)]
        told.append(f"{words}: largest size {number(abs(values[peak]), 3)} {unit} at {number(when, 3)} s.")
        if quantity == "force":
            plot.label(when, values[peak], words, style, anchor="middle")
    plot.words = " ".join(told)
    return plot
