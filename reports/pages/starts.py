"""The spread of several starts: one dot a start, stacked by cost, and the distinct optima with how often each was reached."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

from reports.pages.tolerance import windows_text
from reports.plots.axis import Axis
from reports.plots.figure import Plot
from reports.records.collected import optima
from reports.records.record import StageRecord, StartRecord
from reports.wording import cost, count, percent

_BINS = 40  # across the range of costs


@dataclass(frozen=True)
class Optimum:
    """A distinct optimum: its cost, the starts that reached it, and its contact windows."""

    cost: float
    starts: list[StartRecord]
    windows: str

    @property
    def reached_from(self) -> str:
        """Where its starts began: softplus chain (1); random inputs (5, 7)."""
        kinds = dict.fromkeys(start.start for start in sorted(self.starts, key=lambda start: start.number))
        numbers = {kind: sorted(start.number for start in self.starts if start.start == kind) for kind in kinds}
        return "; ".join(f"{kind} ({', '.join(map(str, numbers[kind]))})" for kind in kinds)


@dataclass(frozen=True)
class Spread:
    """words: how many were solved, the cheapest, the median and the dearest."""

    words: str
    plot: Plot | None
    optima: list[Optimum]
    failed: list[StartRecord]


def spread(stage: StageRecord) -> Spread | None:
    """None for a stage with a single start."""
    if not stage.starts:
        return None
    found = [Optimum(price, same, windows_text(same[0].windows)) for price, same in optima(stage.starts)]
    failed = [start for start in stage.starts if start.cost is None]
    costs = [start.cost for start in stage.starts if start.cost is not None]
    total = len(stage.starts)
    if not costs:
        return Spread(f"None of {count(total, 'start')} was solved.", None, [], failed)
    words = (
        f"{len(costs)} of {count(total, 'start')} were solved ({percent(len(costs) / total).lstrip('+')}); cost {cost(min(costs))} at least, "
        f"{cost(statistics.median(costs))} in the median, {cost(max(costs))} at most; {count(len(found), 'distinct optimum', 'distinct optima')}, "
        f"the cheapest reached {count(len(found[0].starts), 'time')}."
    )
    return Spread(words, _plot(stage.starts, words), found, failed)


def _plot(starts: tuple[StartRecord, ...], words: str) -> Plot:
    solved = sorted(((start.cost, start) for start in starts if start.cost is not None), key=lambda item: item[0])
    low, high = solved[0][0], solved[-1][0]
    width = (high - low) / _BINS or 1.0
    stacks: dict[int, list[tuple[float, StartRecord]]] = {}
    for price, start in solved:
        stacks.setdefault(int((price - low) / width), []).append((price, start))
    tallest = max(len(stack) for stack in stacks.values())
    plot = Plot(
        "Cost of every start",
        Axis.fitted("cost", "", [low, high]),
        Axis.fitted("starts at this cost", "", [tallest], zero=True, margin=0.1),
        words,
        width=560,
        height=140 + 9 * tallest,
    )
    for stack in stacks.values():
        for place, (price, start) in enumerate(stack, 1):
            tip = f"Start {start.number}, {start.start}: cost {cost(price)}; {windows_text(start.windows)}"
            plot.point(price, place, "direct", "circle", tip)
    return plot
