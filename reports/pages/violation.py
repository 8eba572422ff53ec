"""Fig. 2 of the paper: the worst-case violation D against eps."""

from __future__ import annotations

import math

from models.results.run import SceneRecord, ViolationPoint
from reports.pages.section import Report, Section
from reports.paper import SCENE
from reports.plots import Axis, Key, Plot
from reports.wording import error, number, small

_LAWS = {
    "softplus": ("softplus", "D = (k L ln 2 / ln ε)²", "c0", "circle"),
    "relaxed_lcp": ("relaxed LCP", "D = ε", "c1", "square"),
}


def build(report: Report, scene: SceneRecord) -> Section | None:
    """Return the section, None for another scene, or without measured points."""
    campaign = report.stored.campaign if scene.name == SCENE else None
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
    # The force k L [N] at the scene's length, from the closed form of softplus contact.
    softplus = (point for point in points if point.law == "softplus" and point.eps != 1)
    force = next(
        (
            math.sqrt(abs(point.closed_form)) * abs(math.log(point.eps)) / math.log(2.0)
            for point in softplus
        ),
        None,
    )
    values = {"plot": plot, "laws": laws, "worst": worst, "force": force}
    return Section("violation", "Fig. 2: worst-case violation", "scene.html#violation", values)


def _difference(point: ViolationPoint) -> float:
    return (
        abs(point.measured - point.closed_form) / abs(point.closed_form)
        if point.closed_form
        else abs(point.measured)
    )
