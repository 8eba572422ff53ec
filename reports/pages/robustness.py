"""The page of how much a plan can take: shares of perturbed worlds in which it arrives, against size, and where it first fails along each perturbation."""

from __future__ import annotations

from pathlib import Path

from reports.pages.player import Film, film
from reports.pages.section import Section
from reports.plots.axis import Axis
from reports.plots.figure import Key, Plot
from reports.records.record import RunRecord
from reports.records.robustness_record import RobustnessRecord
from reports.traces import Motion, read_trace
from reports.wording import number as in_digits

_STYLES = ("c0", "c1")


def build(record: RobustnessRecord, run: RunRecord | None = None, folder: Path | None = None) -> Section:
    """The section of the page. run: of the plan, as far as it is drawn; folder: where plan.nc and worlds/<number>.nc are, which then move in the player."""
    values = {
        "record": record,
        "plot": _plot(record),
        "keys": [Key(_STYLES[index], way.name) for index, way in enumerate(record.ways)],
        "failures": sorted(record.failures, key=lambda item: (item.sizes is None, item.sizes)),
        "worlds": [] if run is None or folder is None else _worlds(record, run, folder),
    }
    return Section("robustness", "How much it can take", "robustness.html#plan", values)


def _worlds(record: RobustnessRecord, run: RunRecord, folder: Path) -> list[tuple[str, Film]]:
    """(what happened there, the film) of the worlds whose motion is stored."""
    plan, found = read_trace(folder / "plan.nc", run.scene), []
    for number, ratio in record.shown:
        moving = film(run, [Motion(plan=plan, replay=read_trace(folder / "worlds" / f"{number}.nc", run.scene))])
        what = (
            "it does not come to its end"
            if ratio is None
            else f"it {'arrives' if ratio <= 1 else 'misses'}, at {in_digits(ratio, 2)} of its limit"
        )
        found += [] if moving is None else [(f"World {number}: {what}", moving)]
    return found


def _plot(record: RobustnessRecord) -> Plot | None:
    """Shares against size, with their intervals."""
    curves = [(index, way.name, way.curve) for index, way in enumerate(record.ways) if way.curve is not None and way.curve.scales]
    if not curves:
        return None
    scales = [scale for _, _, curve in curves for scale in curve.scales]
    halves = "; ".join(
        f"{name}, half of the worlds are left at {in_digits(curve.half, 3)} times these sizes"
        for _, name, curve in curves
        if curve.half is not None
    )
    plot = Plot(
        "Share of worlds in which it arrives", Axis.fitted("all sizes times", "", scales, log=True),
        Axis.fitted("share", "", [0.0, 1.0], zero=True), f"Shares with their 95 % intervals{': ' if halves else '.'}{halves}{'.' if halves else ''}", width=560,
    )  # fmt: skip
    for index, name, curve in curves:
        style = _STYLES[index]
        plot.line(name, style, curve.scales, [item.share for item in curve.shares])
        for scale, item in zip(curve.scales, curve.shares, strict=True):
            plot.line(f"{name}, interval", f"{style} soft", [scale, scale], list(item.interval))
            plot.point(scale, item.share, style, "circle", f"{name}, {in_digits(scale)} times: {item.words}", radius=3.0)
    return plot
