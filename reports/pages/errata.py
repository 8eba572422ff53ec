"""Errata of the paper, each with what our records show of it where they can; and its Fig.

2, the worst-case violation D against eps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from reports.pages.section import Report, Section
from reports.plots import Axis, Key, Plot
from reports.records.record import ViolationPoint
from reports.rows import Row
from reports.wording import error, listing, number, seconds, small

_LAWS = {
    "softplus": ("softplus", "D = (k L ln 2 / ln ε)²", "c0", "circle"),
    "relaxed_lcp": ("relaxed LCP", "D = ε", "c1", "square"),
}


def build(report: Report) -> Section | None:
    """The section, or None where no stage is stored that the paper has too."""
    rows = [
        row
        for scene in filter(report.is_papers, report.scenes)
        for row in report.rows_of_scene(scene)
    ]
    if not rows:
        return None
    values = {"closed_form": _closed_form(report), "physics": _physics(rows), "clock": _clock(rows)}
    said = "Eight errata of the paper, each with what our records show of it, and its Fig. 2: the worst-case violation against ε."
    return Section(
        "errata",
        "Errata of the paper, and what it leaves open",
        "paper.html#errata",
        values,
        said=said,
    )


def _closed_form(report: Report) -> str:
    campaign = report.stored.campaign
    points = (
        [point for point in campaign.violation if point.law == "softplus" and point.closed_form]
        if campaign
        else []
    )
    if not points:
        return ""
    worst = max(abs(point.measured / point.closed_form - 1) for point in points)
    return f"Measured here at {len(points)} values of ε: the largest relative difference to the closed form is {error(worst)}."


def _physics(rows: Sequence[Row]) -> str:
    found = [
        (row.label, value)
        for row in rows
        if row.stage.method == "relu_gd" and (value := row.metric("physics")) is not None
    ]
    if not found:
        return ""
    if all(value == 0 for _, value in found):
        return f"Here it is exactly 0 of {listing([label for label, _ in found])}."
    return f"Here: {listing([f'{number(value, 3)} of {label}' for label, value in found])}."


def _clock(rows: Sequence[Row]) -> str:
    warm = [
        row
        for row in rows
        if row.paper_total and len(row.methods) > 1 and row.stage.paper.get("time")
    ]
    if not warm:
        return ""
    most = max(warm, key=lambda row: (row.paper_total or 0.0) / row.stage.paper["time"])
    return (
        f"The most flattered row of the paper is {most.label}: {seconds(most.stage.paper['time'])} s as printed, "
        f"{seconds(most.paper_total)} s with the stages before it; here {seconds(most.stage.seconds.stage)} s and {seconds(most.stage.seconds.total)} s."
    )


def violation(report: Report) -> Section | None:
    """The section, or None where the campaign measured no point."""
    campaign = report.stored.campaign
    points = [point for point in campaign.violation if point.eps > 0] if campaign else []
    if not points:
        return None
    x = Axis.fitted("ε", "", [point.eps for point in points], log=True)
    y = Axis.fitted(
        "worst violation D",
        "N²",
        [value for point in points for value in (point.measured, point.closed_form)],
        log=True,
    )
    plot = Plot("Worst-case violation D against ε", x, y, width=720, height=360)
    worst, laws = [], []
    for law in dict.fromkeys(point.law for point in points):
        name, formula, style, marker = _LAWS.get(law, (law, "closed form", "c2", "diamond"))
        mine = sorted((point for point in points if point.law == law), key=lambda point: point.eps)
        plot.line(
            f"{name}, closed form",
            f"{style} soft",
            [point.eps for point in mine],
            [point.closed_form for point in mine],
        )
        for point in mine:
            plot.point(
                point.eps,
                point.measured,
                style,
                marker,
                f"{name}, ε = {small(point.eps)}: D = {number(point.measured, 6)} N²",
            )
        plot.keys += [
            Key(f"{style} soft", f"{name}: {formula}"),
            Key(style, f"{name}: measured", marker),
        ]
        middle = mine[len(mine) // 3]
        plot.label(middle.eps, middle.closed_form, f"{name}: {formula}", style)
        laws.append((name, formula, mine))
        worst.append((name, len(mine), max(_difference(point) for point in mine)))
    plot.words = " ".join(
        f"{name}: D falls from {error(mine[-1].measured)} N² at ε = {small(mine[-1].eps)} to {error(mine[0].measured)} N² at ε = {small(mine[0].eps)}."
        for name, _, mine in laws
    )
    # The force k L [N] at a penetration of the scene's length, which D of softplus contact goes by:
    # from its closed form.
    softplus = (point for point in points if point.law == "softplus" and point.eps != 1)
    force = next(
        (
            math.sqrt(abs(point.closed_form)) * abs(math.log(point.eps)) / math.log(2.0)
            for point in softplus
        ),
        None,
    )
    values = {"plot": plot, "laws": laws, "worst": worst, "force": force}
    return Section("violation", "Fig. 2: worst-case violation", "paper.html#violation", values)


def _difference(point: ViolationPoint) -> float:
    return (
        abs(point.measured - point.closed_form) / abs(point.closed_form)
        if point.closed_form
        else abs(point.measured)
    )
