"""Two runs of the suite beside each other: what got slower or larger beyond the noise of both.

    comparison = compare(before, after)
    comparison.regressions

A row of ours is a regression only if three things hold together: its median is more than 15 % above
that of before (memory: and 2 MiB more); the samples of the two runs are told apart by a rank test
(Mann-Whitney, one-sided, exact, p <= 1 %: with five rounds each, at most one pair in the wrong
order); and for times, both after the samples were divided by those of the yardstick, so that
another or a busier machine is not taken for slower code. A stage that gave an answer before and
gives none now is a regression too. Peers are told, and are none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from statistics import median

from benchmarks.records import SuiteRecord, SuiteRow, middle
from benchmarks.suite.cases import OURS, YARDSTICK

FACTOR = 1.15
LEAST_MEMORY = 2.0
SIGNIFICANCE = 0.01
_Key = tuple[str, str, int, int]


class Kind(Enum):
    REGRESSION = "slower"
    PEER = "peer slower"
    IMPROVEMENT = "faster"
    UNTOLD = "cannot be told"


@dataclass(frozen=True, kw_only=True)
class Change:
    """quantity: `CPU s`, `wall s`, `MiB` or `answer`.

    before, after: medians, None where there are none; factor: after by before, times already
    corrected

    for the speed of the machine; why: in words.
    """

    kind: Kind
    row: SuiteRow
    quantity: str
    before: float | None
    after: float | None
    factor: float | None
    why: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """speed: how much longer the yardstick takes now (by size); pairs: rows in both runs.

    changes: regressions first.
    """

    changes: tuple[Change, ...]
    pairs: int
    speed: float | None

    @property
    def regressions(self) -> tuple[Change, ...]:
        return tuple(change for change in self.changes if change.kind is Kind.REGRESSION)


def compare(before: SuiteRecord, after: SuiteRecord) -> Comparison:
    """Every difference beyond noise between two runs.

    Rows that only one of them has are passed over.
    """
    old, new = _table(before), _table(after)
    common = [key for key in new if key in old and key[0] != YARDSTICK]
    speeds = [
        median(new[key].cpu_s) / median(old[key].cpu_s)
        for key in new
        if key[0] == YARDSTICK and key in old and _both(old[key], new[key])
    ]
    overall = middle(tuple(speeds))
    changes: list[Change] = []
    for key in common:
        yard = (YARDSTICK, OURS, *key[2:])
        sized = yard in old and yard in new and _both(old[yard], new[yard])
        speed = median(new[yard].cpu_s) / median(old[yard].cpu_s) if sized else overall or 1.0
        changes += _changes(old[key], new[key], speed)
    order = list(Kind)
    changes.sort(key=lambda change: (order.index(change.kind), -(change.factor or math.inf)))
    return Comparison(changes=tuple(changes), pairs=len(common), speed=overall)


def _table(record: SuiteRecord) -> dict[_Key, SuiteRow]:
    return {(row.stage, row.by, row.n, row.steps): row for row in record.rows}


def _both(old: SuiteRow, new: SuiteRow) -> bool:
    return bool(old.cpu_s) and bool(new.cpu_s)


def _changes(old: SuiteRow, new: SuiteRow, speed: float) -> list[Change]:
    if old.failed and new.failed:
        return []
    if old.failed or new.failed:
        kind = Kind.IMPROVEMENT if old.failed else _worse(new)
        return [
            Change(
                kind=kind, row=new, quantity="answer", before=middle(old.cpu_s),
                after=middle(new.cpu_s), factor=None,
                why=new.failed or "it gives an answer now",
            )
        ]  # fmt: skip
    scaled = tuple(sample / speed for sample in new.cpu_s)
    found = [_change(old, new, f"{new.clock} s", old.cpu_s, scaled, new.cpu_s, 0.0)]
    found.append(
        _change(old, new, "MiB", old.memory_mib, new.memory_mib, new.memory_mib, LEAST_MEMORY)
    )
    return [change for change in found if change is not None]


def _worse(row: SuiteRow) -> Kind:
    return Kind.REGRESSION if row.by == OURS else Kind.PEER


def _change(
    old: SuiteRow,
    new: SuiteRow,
    quantity: str,
    was: tuple[float, ...],
    now: tuple[float, ...],
    shown: tuple[float, ...],
    least: float,
) -> Change | None:
    """None: no more than noise."""
    if not was or not now:
        return None
    first, last = median(was), median(now)
    if abs(last - first) < least or max(first, last) <= FACTOR * min(first, last):
        return None
    factor = last / first if first > 0 else None
    slower = last > first
    chance = _chance(was, now) if slower else _chance(now, was)
    if chance <= SIGNIFICANCE:
        kind, why = (
            (_worse(new) if slower else Kind.IMPROVEMENT),
            f"by chance in {100 * chance:.2g} % of such pairs of runs",
        )
    elif math.comb(len(was) + len(now), len(now)) * SIGNIFICANCE < 1.0:
        kind, why = (
            Kind.UNTOLD,
            f"{len(was)} and {len(now)} samples are too few to tell it from noise",
        )
    else:
        return None
    return Change(
        kind=kind,
        row=new,
        quantity=quantity,
        before=first,
        after=median(shown),
        factor=factor,
        why=why,
    )


def _chance(low: Sequence[float], high: Sequence[float]) -> float:
    """Probability that samples of one distribution are at least as well ordered as these: the exact one-sided Mann-Whitney test."""
    from scipy.stats import mannwhitneyu

    return float(mannwhitneyu(high, low, alternative="greater", method="exact").pvalue)
