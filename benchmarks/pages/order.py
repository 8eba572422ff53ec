"""Step size and order: what a finer grid and a scheme of higher order buy, and which grid reaches an error at the least CPU time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace

from benchmarks.pages.chart import Point, chart
from benchmarks.records import (
    AnyRecord,
    OrderAnswer,
    OrderChoice,
    OrderRecord,
    OrderRow,
    OrderScene,
)
from reports.pages.section import Section
from reports.plots import Plot
from reports.wording import error, listing, power, seconds, small, spaced, times

_NAMES = {
    "semi_implicit_euler": "semi-implicit Euler",
    "implicit_midpoint": "implicit midpoint",
    "radau_iia_2": "Radau IIA, 2 stages",
    "radau_iia_3": "Radau IIA, 3 stages",
}


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no scene was measured."""
    views = [
        _view(scene)
        for record in records
        if isinstance(record, OrderRecord)
        for scene in record.scenes
    ]
    return (
        Section(
            "order", "Step size and order", "order.html", {"views": views, "named": scheme_name}
        )
        if views
        else None
    )


def scheme_name(name: str) -> str:
    """What an integration scheme is called."""
    return _NAMES.get(name, spaced(name))


def _view(scene: OrderScene) -> SimpleNamespace:
    plots = [
        _plot(
            scene,
            "Replay error over CPU time",
            ("CPU time", "s"),
            lambda row: row.cpu_s,
            lambda row: row.replay_error,
            "replay error",
        ),
        _plot(
            scene,
            "Replay error over the step",
            ("step h", "s"),
            lambda row: row.h,
            lambda row: row.replay_error,
            "replay error",
        ),
        _plot(
            scene,
            "Distance to the finest plan over the step",
            ("step h", "s"),
            lambda row: row.h,
            lambda row: row.plan_error,
            "plan error",
        ),
    ]
    known = [
        f"{scheme_name(name)} {order:.1f}"
        for name, order in scene.orders.items()
        if order is not None
    ]
    failed = [
        f"{scheme_name(row.scheme)} with {row.steps} steps ({spaced(row.outcome)})"
        for row in scene.rows
        if row.outcome != "solved"
    ]
    return SimpleNamespace(
        scene=scene,
        plots=[plot for plot in plots if plot is not None],
        answers=[_sentence(answer, scene.unit) for answer in scene.answers],
        orders=f"Order of the replay error in h, fitted over all grids: {listing(known)}."
        if known
        else "Too few grids for an order.",
        failed=f"Without a plan that was solved: {listing(failed)}." if failed else "",
    )


def _plot(
    scene: OrderScene,
    title: str,
    across: tuple[str, str],
    x_of: Callable[[OrderRow], float],
    y_of: Callable[[OrderRow], float | None],
    what: str,
) -> Plot | None:
    series: dict[str, list[Point]] = {}
    for row in sorted(scene.rows, key=lambda row: row.steps):
        y = y_of(row)
        if row.outcome == "solved" and y is not None and y > 0 and x_of(row) > 0:
            tip = f"{scheme_name(row.scheme)}, {row.steps} steps of {error(row.h)} s: {what} {error(y)} {scene.unit}, {seconds(row.cpu_s)} CPU s"
            series.setdefault(scheme_name(row.scheme), []).append((x_of(row), y, tip))
    plot = chart(
        title,
        across,
        (what, scene.unit),
        {name: series[name] for name in map(scheme_name, scene.orders) if name in series},
        lines=True,
        height=360,
    )
    if plot is not None:
        best = min(
            (y, row.steps, row.scheme)
            for row in scene.rows
            if row.outcome == "solved" and (y := y_of(row)) is not None and y > 0
        )
        plot.words = f"{sum(map(len, series.values()))} grids; the smallest {what} is {error(best[0])} {scene.unit}, {scheme_name(best[2])} with {best[1]} steps."
    return plot


def _sentence(answer: OrderAnswer, unit: str) -> str:
    target = f"{small(answer.target) if answer.target < 1 else power(0)} {unit}"
    best, euler = answer.best, answer.euler
    if best is None:
        return f"Within {target}: none of the grids that were tried."
    said = f"Within {target}: cheapest is {_words(best)}."
    if best.scheme == "semi_implicit_euler":
        return said
    if euler is None:
        return f"{said} No grid of semi-implicit Euler that was tried gets there."
    ratio = euler.cpu_s / best.cpu_s if best.cpu_s > 0 else 1.0
    return f"{said} Semi-implicit Euler needs {euler.steps} steps and {times(ratio)} the time, {seconds(euler.cpu_s)} s."


def _words(choice: OrderChoice) -> str:
    return f"{scheme_name(choice.scheme)} with {choice.steps} steps, {seconds(choice.cpu_s)} CPU s (error {error(choice.replay_error)})"
