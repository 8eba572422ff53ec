"""The optimum through soft contact against that of rigid bodies, as the contact gets stiffer: from what a benchmark left."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

from benchmarks.records import AnyRecord, RigidLimitCase, RigidLimitRecord, StiffnessRow
from reports.pages.section import Section
from reports.plots import Axis, Key, Plot
from reports.wording import number

# A plan this near to the rigid optimum is said to have reached it, as a share of that optimum.
_NEAR = 0.01


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no case has a cost."""
    cases = [
        case for record in records if isinstance(record, RigidLimitRecord) for case in record.cases
    ]
    views = [_view(case) for case in cases if any(row.cost is not None for row in case.rows)]
    if not views:
        return None
    return Section(
        "rigid-limit",
        "Soft contact against rigid bodies",
        "rigid_limit.html",
        {"views": views, "excess": _excess},
    )


def _excess(cost: float, case: RigidLimitCase) -> float:
    """How far a cost is above the rigid optimum [%]."""
    return 100.0 * (cost / case.rigid - 1.0)


def _solved(case: RigidLimitCase) -> list[tuple[StiffnessRow, float]]:
    return sorted(
        ((row, row.cost) for row in case.rows if row.cost is not None), key=lambda pair: pair[0].k
    )


def _view(case: RigidLimitCase) -> SimpleNamespace:
    solved = _solved(case)
    replayed = [(row, row.replayed_cost) for row, _ in solved if row.replayed_cost is not None]
    band = [case.rigid * (1 - _NEAR), case.rigid * (1 + _NEAR)]
    plot = Plot(
        f"{case.title}: least cost against stiffness",
        Axis.fitted("contact stiffness", "N/m", [row.k for row, _ in solved], log=True),
        Axis.fitted("cost", "1", [*(cost for _, cost in [*solved, *replayed]), *band]),
        width=720,
        height=360,
    )
    for points, style, marker, words in (
        (solved, "c0", "circle", "plan"),
        (replayed, "c1", "square", "its inputs in the continuous dynamics"),
    ):
        if not points:
            continue
        plot.keys.append(Key(style, words, marker))
        plot.line(words, style, [row.k for row, _ in points], [cost for _, cost in points])
        for row, cost in points:
            tip = f"k = {number(row.k)} N/m, {row.steps} steps, {words}: {number(cost, 6)}, {number(_excess(cost, case), 3)} % from rigid bodies"
            plot.point(row.k, cost, style, marker, tip)
    plot.level(case.rigid, f"rigid bodies: {number(case.rigid, 6)}")
    for value, words in zip(band, ("1 % below", "1 % above"), strict=True):
        plot.level(value, words)
    plot.words = "Each point is the cheapest plan found at one stiffness; the level is the optimum of rigid bodies, from its closed form."
    return SimpleNamespace(case=case, plot=plot, sentence=_sentence(case, solved))


def _sentence(case: RigidLimitCase, solved: list[tuple[StiffnessRow, float]]) -> str:
    (softest, first), (stiffest, last) = solved[0], solved[-1]
    words = (
        f"From k = {number(softest.k)} to {number(stiffest.k)} N/m the least cost found goes from {number(first, 6)} to {number(last, 6)}, "
        f"{number(_excess(first, case), 3)} % and {number(_excess(last, case), 3)} % from the {number(case.rigid, 6)} of rigid bodies."
    )
    near = next(
        (
            place
            for place in range(len(solved))
            if all(abs(_excess(cost, case)) <= 100 * _NEAR for _, cost in solved[place:])
        ),
        None,
    )
    if near is None:
        return f"{words} Not even the stiffest is within {number(100 * _NEAR)} % of it."
    return f"{words} From k = {number(solved[near][0].k)} N/m on it is within {number(100 * _NEAR)} % of it."
