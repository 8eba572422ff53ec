"""Errata of the paper, each with what our records show of it where they can, and what the paper leaves open."""

from __future__ import annotations

from reports.pages.section import Report, Section
from reports.paper import SCENE
from reports.wording import error, listing, number, seconds


def build(report: Report) -> Section | None:
    """The section, or None where the paper's scene was not run."""
    rows = [row for row in report.rows if row.run.scene.name == SCENE]
    if not rows:
        return None
    return Section(
        "errata",
        "Errata of the paper, and what it leaves open",
        "errata.html",
        {"closed_form": _closed_form(report), "physics": _physics(report), "clock": _clock(report)},
        said="Eight errata of the paper, each with what our records show of it, and its Fig. 2: the worst-case violation against ε.",
    )


def _closed_form(report: Report) -> str:
    campaign = report.stored.campaign
    points = [point for point in campaign.violation if point.law == "softplus" and point.closed_form] if campaign else []
    if not points:
        return ""
    worst = max(abs(point.measured / point.closed_form - 1) for point in points)
    return f"Measured here at {len(points)} values of ε: the largest relative difference to the closed form is {error(worst)}."


def _physics(report: Report) -> str:
    found = [(row.label, value) for row in report.rows if row.stage.method == "relu_gd" and (value := row.metric("physics")) is not None]
    if not found:
        return ""
    if all(value == 0 for _, value in found):
        return f"Here it is exactly 0 of {listing([label for label, _ in found])}."
    return f"Here: {listing([f'{number(value, 3)} of {label}' for label, value in found])}."


def _clock(report: Report) -> str:
    warm = [row for row in report.rows if row.paper_total and len(row.methods) > 1 and row.stage.paper.get("time")]
    if not warm:
        return ""
    most = max(warm, key=lambda row: (row.paper_total or 0.0) / row.stage.paper["time"])
    return (
        f"The most flattered row of the paper is {most.label}: {seconds(most.stage.paper['time'])} s as printed, "
        f"{seconds(most.paper_total)} s with the stages before it; here {seconds(most.stage.seconds.stage)} s and {seconds(most.stage.seconds.total)} s."
    )
