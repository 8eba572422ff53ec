"""Random starts of an unstable scene: which are balanced, by a wall or without, and what the open loop makes of the same plans."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from types import SimpleNamespace

from benchmarks.records import AnyRecord, BalanceRecord, BalanceStart
from reports.pages.section import Section
from reports.plots import Axis, Key, Plot
from reports.wording import error, number

# Style, marker and words of a start: balanced without a wall, by a wall, not balanced.
_FREE = ("c0", "circle", "balanced without a wall")
_WALL = ("c5", "square", "balanced by a wall")
_LOST = ("c3", "diamond", "not balanced")


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no start was tried."""
    views = [
        _view(record) for record in records if isinstance(record, BalanceRecord) and record.starts
    ]
    return (
        Section("unstable-starts", "Unstable starts", "unstable_starts.html", {"views": views})
        if views
        else None
    )


def _look(start: BalanceStart) -> tuple[str, str, str]:
    if not start.balanced:
        return _LOST
    return _WALL if start.wall_impulse > 0.0 else _FREE


def _view(record: BalanceRecord) -> SimpleNamespace:
    keys = [Key(style, words, marker) for style, marker, words in (_FREE, _WALL, _LOST)]
    lost = [
        (number, start) for number, start in enumerate(record.starts, start=1) if not start.balanced
    ]
    return SimpleNamespace(
        record=record,
        keys=keys,
        plots=[_starts(record), _ends(record)],
        sentence=_sentence(record),
        lost=lost,
    )


def _tip(place: int, start: BalanceStart) -> str:
    ends = f"end {error(start.tracked_end)} with feedback, {error(start.open_end)} without"
    return f"start {place} at {number(start.x, 3)} m, {number(start.theta, 3)} rad: {_look(start)[2]}, {ends}, feedback {number(start.effort, 2)}"


def _starts(record: BalanceRecord) -> Plot:
    plot = Plot(
        "Where the pole starts",
        Axis.fitted("place of the cart", "m", [start.x for start in record.starts], margin=0.05),
        Axis.fitted(
            "angle of the pole", "rad", [start.theta for start in record.starts], margin=0.05
        ),
    )
    for place, start in enumerate(record.starts, start=1):
        style, marker, _ = _look(start)
        plot.point(start.x, start.theta, style, marker, _tip(place, start))
    plot.words = "The further the pole leans out, and the closer to a wall, the more it is the wall that throws it back."
    return plot


def _ends(record: BalanceRecord) -> Plot:
    known = [
        (place, start, start.open_end, start.tracked_end)
        for place, start in enumerate(record.starts, start=1)
    ]
    shown = [
        (place, start, x, y)
        for place, start, x, y in known
        if x is not None and y is not None and x > 0.0 and y > 0.0
    ]
    plot = Plot(
        "The same inputs without feedback and with it",
        Axis.fitted("end in the open loop", "", [x for _, _, x, _ in shown] or [1.0], log=True),
        Axis.fitted("end with feedback", "", [*(y for *_, y in shown), record.limit], log=True),
    )
    plot.level(record.limit, f"limit {number(record.limit, 2)}")
    for place, start, x, y in shown:
        style, marker, _ = _look(start)
        plot.point(x, y, style, marker, _tip(place, start))
    plot.words = (
        "Distance of the last state from the goal, norm over places and speeds in SI units."
    )
    return plot


def _sentence(record: BalanceRecord) -> str:
    balanced = [start for start in record.starts if start.balanced]
    walls = [start for start in balanced if start.wall_impulse > 0.0]
    alone = sum(start.open_end is not None and start.open_end <= record.limit for start in balanced)
    margin = sum(start.share < 1.0 for start in balanced)
    cpu = [start.plan_cpu_s for start in record.starts]
    words = f"{len(balanced)} of {len(record.starts)} starts are balanced in the replay with feedback, {len(walls)} of them by a wall; "
    words += (
        f"in the open loop {alone} of these plans end as near." if balanced else "no plan holds."
    )
    for name, group in (
        ("without a wall", [start for start in balanced if start not in walls]),
        ("by a wall", walls),
    ):
        efforts = [start.effort for start in group if start.effort is not None]
        if efforts:
            words += f" Balanced {name}, the feedback's RMS effort is {number(100 * median(efforts), 2)} % of the half-range of the inputs in the median, at most {number(100 * max(efforts), 2)} %."
    if margin:
        words += f" {margin} of them needed a plan that leaves the feedback some of the inputs."
    return (
        words
        + f" Finding a plan took {error(median(cpu))} CPU s in the median, at most {error(max(cpu))}."
    )
