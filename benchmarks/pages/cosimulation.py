"""Coupled FMUs: energy error and CPU time against the macro step, every master beside the whole scene as one FMU."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from types import SimpleNamespace

from benchmarks.records import AnyRecord, CosimCase, CosimMaster, CosimRecord
from reports.pages.section import Section
from reports.plots import Axis, Key, Plot
from reports.wording import clean, error, listing, number, small

# Master -> words, CSS class, marker.
_MASTERS = {
    "jacobi": ("Jacobi", "c0", "circle"),
    "contact_first": ("contact first (Gauss-Seidel)", "c1", "square"),
    "extrapolated": ("contact first, force extrapolated", "c2", "diamond"),
    "iterated": ("iterated with rollback", "c3", "circle"),
    "libcosim": ("libcosim, fixed step", "c4", "diamond"),
    "libcosim_ecco": ("libcosim, ECCO", "plan", "square"),
    "whole": ("one FMU, contact inside", "c5", "circle"),
}
# Masters whose figures a sentence compares.
_TOLD = ("jacobi", "contact_first", "extrapolated", "iterated")
# The criterion: omega h below this.
CRITERION = 0.1
# What an energy error may be for a result to be of use, and below which an error is rounding.
_USEFUL = 0.01
_SMALLEST = 1e-13


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no case was cut."""
    cases = [case for record in records if isinstance(record, CosimRecord) for case in record.cases]
    views = [_view(case) for case in cases if any(master.rows for master in case.masters)]
    if not views:
        return None
    return Section(
        "cosimulation",
        "Split into FMUs: what it costs",
        "cosimulation.html",
        {"views": views, "words": words_of},
    )


def words_of(master: CosimMaster) -> str:
    """What a coupling method is called."""
    return _look(master.name)[0]


def _look(name: str) -> tuple[str, str, str]:
    """Words, CSS class and marker of a master; one that this page does not know keeps its name."""
    return _MASTERS.get(name, (clean(name), "c0", "circle"))


def _view(case: CosimCase) -> SimpleNamespace:
    masters = [master for master in case.masters if master.rows]
    drift = max(abs(row.momentum_error) for master in masters for row in master.rows)
    largest = max(abs(row.energy_error) for master in masters for row in master.rows)
    momentum = (
        f"Momentum is right to {error(drift)} kg m/s in every one of these runs, also where the energy is off by {_percent(largest)}: "
        "it shows nothing. Check the energy."
    )
    failed = [(words_of(master), master.failed) for master in case.masters if master.failed]
    plots = [_against_step(case, masters), _against_time(case, masters)]
    return SimpleNamespace(case=case, plots=plots, momentum=momentum, failed=failed)


def _size(value: float) -> float:
    return max(abs(value), _SMALLEST)


def _curve(master: CosimMaster) -> list[tuple[float, float]]:
    """(macro step really made, size of the energy error)."""
    return [(row.mean_step, _size(row.energy_error)) for row in master.rows]


def _draw(
    plot: Plot, master: CosimMaster, points: list[tuple[float, float]], tips: list[str]
) -> None:
    words, style, marker = _look(master.name)
    plot.keys.append(Key(style, words, marker))
    if master.name != "libcosim":  # it lies on Jacobi's line, which shows through
        plot.line(words, style, [x for x, _ in points], [y for _, y in points])
    for (x, y), tip in zip(points, tips, strict=True):
        plot.point(x, y, style, marker, f"{words}: {tip}")


def _against_step(case: CosimCase, masters: list[CosimMaster]) -> tuple[Plot, str]:
    curves = {master.name: sorted(_curve(master)) for master in masters}
    plot = Plot(
        "Energy error against the macro step",
        Axis.fitted(
            "macro step h", "s", [h for points in curves.values() for h, _ in points], log=True
        ),
        Axis.fitted(
            "relative energy error",
            "",
            [value for points in curves.values() for _, value in points],
            log=True,
        ),
        width=720,
        height=400,
    )
    limit = CRITERION / case.frequency
    if limit > plot.x.low:
        plot.band(plot.x.low, min(limit, plot.x.high), "touch")
        plot.keys.append(Key("touch", f"ωh < {number(CRITERION)}", "swatch"))
    for master in masters:
        rows = sorted(master.rows, key=lambda row: row.mean_step)
        tips = [
            f"h = {small(row.mean_step)} s, energy {error(row.energy_error)}, momentum {error(row.momentum_error)}"
            for row in rows
        ]
        _draw(plot, master, curves[master.name], tips)
    plot.words = f"{len(curves)} masters; the smaller the step, the smaller the error of each."
    return plot, _conclusion(case, curves, limit)


def _conclusion(case: CosimCase, curves: dict[str, list[tuple[float, float]]], limit: float) -> str:
    """What the criterion is worth: errors there, and the steps that a useful result needs."""
    there = {
        name: value
        for name in _TOLD
        if name in curves and (value := at(curves[name], limit)) is not None
    }
    sentences = []
    if there:
        told = listing(
            [f"{_percent(value)} ({_MASTERS[name][0]})" for name, value in there.items()]
        )
        sentences.append(
            f"At ωh = {number(CRITERION)}, here h = {number(limit, 2)} s, the energy is off by {told}."
        )
    needs = {
        name: step
        for name in _TOLD
        if name in curves and (step := reached(curves[name], _USEFUL)) is not None
    }
    if needs:
        told = listing(
            [
                f"{_needed(case, curves[name], step)} ({_MASTERS[name][0]})"
                for name, step in needs.items()
            ]
        )
        sentences.append(f"For an error below {_percent(_USEFUL)} it takes ωh of at most {told}.")
    poor = [_MASTERS[name][0] for name in _TOLD if name in curves and name not in needs]
    if poor:
        sentences.append(f"No step of this sweep is small enough for {listing(poor)}.")
    if "whole" in curves:
        worst = max(value for _, value in curves["whole"])
        sentences.append(
            f"The whole scene in one FMU is right to {error(worst)} at every one of these steps: keep a stiff contact inside."
        )
    return " ".join(sentences)


def _needed(case: CosimCase, curve: list[tuple[float, float]], step: float) -> str:
    """The product omega h, or that any step will do."""
    words = number(step * case.frequency, 2)
    return f"{words}, the largest tried" if step >= max(h for h, _ in curve) else words


def _percent(value: float) -> str:
    return f"{number(value * 100, 2)} %"


def _against_time(case: CosimCase, masters: list[CosimMaster]) -> tuple[Plot, str]:
    rows = {master.name: sorted(master.rows, key=lambda row: row.mean_step) for master in masters}
    plot = Plot(
        "CPU time against energy error",
        Axis.fitted(
            "relative energy error",
            "",
            [_size(row.energy_error) for group in rows.values() for row in group],
            log=True,
        ),
        Axis.fitted(
            "CPU time a simulated second",
            "s",
            [row.cpu_per_s for group in rows.values() for row in group],
            log=True,
        ),
        width=720,
        height=400,
    )
    price: dict[str, float] = {}
    for master in masters:
        group = rows[master.name]
        points = [(_size(row.energy_error), row.cpu_per_s) for row in group]
        tips = [
            f"h = {small(row.mean_step)} s, energy {error(row.energy_error)}, {error(row.cpu_per_s)} CPU s a second"
            for row in group
        ]
        _draw(plot, master, points, tips)
        step = reached(_curve(master), _USEFUL)
        seconds = [(row.mean_step, row.cpu_per_s) for row in group]
        if step is not None:
            price[master.name] = at(seconds, step) or min(
                value for h, value in seconds if h <= step * (1 + 1e-9)
            )
    told = listing(
        [
            f"{error(value)} s by {_look(name)[0]}"
            for name, value in sorted(price.items(), key=lambda item: item[1])
        ]
    )
    plot.words = "Further down is cheaper, further left is better."
    lacking = [words_of(master) for master in masters if master.name not in price]
    sentence = (
        f"An energy error of {_percent(_USEFUL)} costs, a simulated second, {told}."
        if price
        else ""
    )
    if lacking:
        sentence += f" No step of this sweep gets {listing(lacking)} there."
    return plot, sentence.strip()


def reached(points: Iterable[tuple[float, float]], goal: float) -> float | None:
    """The largest setting from which on downwards the error stays at or below `goal`: (setting, error), linear in the logarithms.

    None if even the smallest setting is above; the largest setting if none is.
    """
    ordered = sorted(points)
    if not ordered or ordered[0][1] > goal:
        return None
    for (below, less), (above, more) in pairwise(ordered):
        if more > goal:
            part = math.log(goal / less) / math.log(more / less) if less > 0 else 0.0
            return below * (above / below) ** part
    return ordered[-1][0]


def at(points: Iterable[tuple[float, float]], setting: float) -> float | None:
    """The error at a setting between those measured; None outside, or where a neighbour is zero."""
    ordered = sorted(points)
    for (below, less), (above, more) in pairwise(ordered):
        if below <= setting <= above and less > 0 and more > 0:
            part = math.log(setting / below) / math.log(above / below)
            return less * (more / less) ** part
    return None
