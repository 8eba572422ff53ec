"""How much plans can take: the page of one plan (`validate robust`), and what a campaign's plans that hold survive, scene by scene.

A conclusion counts pairs of plans of one scene whose shares differ by more than chance: their
intervals of 95 % have nothing in common.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import combinations, product
from statistics import median
from typing import NamedTuple

from reports.pages.pareto import keys, style_of
from reports.pages.section import Report, Section
from reports.plots import Axis, Plot, is_wide
from reports.records.record import SceneRecord, ShareRecord, SurveyRecord
from reports.records.robustness_record import RobustnessRecord
from reports.rows import Row
from reports.wording import cost, count, listing, number

_SHARES = Axis.fitted("share", "", [0.0, 1.0], zero=True)
# Costs that differ by less, relatively, are the same.
_SAME_COST = 1e-3
# Fewer pairs that differ by more than chance say nothing.
_ENOUGH = 5


def of_plan(record: RobustnessRecord) -> Section:
    """The page of one plan."""
    values = {
        "record": record,
        "failures": sorted(record.failures, key=lambda item: (item.sizes is None, item.sizes)),
    }
    return Section("robustness", "How much it can take", "robustness.html#plan", values)


class Survivor(NamedTuple):
    """A plan that was tried: its row, what it costs, and how it fares."""

    row: Row
    price: float
    survey: SurveyRecord
    alone: ShareRecord

    @property
    def weakest(self) -> str:
        """Such as `c by -0.0833 N s/m, 0.83 of its size`.

        Empty where it takes all that was tried.
        """
        found = self.survey
        if found.sizes is None or found.amount is None:
            return ""
        of = "" if found.unit == "1" else f" {found.unit}"
        return f"{found.weakest} by {found.amount:+.3g}{of}, {number(found.sizes, 2)} of its size"


def build(report: Report) -> Section | None:
    """The section of a campaign: cost against the share of perturbed worlds in which a plan arrives; None where no plan was tried."""
    scenes = [
        (scene, report.scene_link(scene), plans)
        for scene in report.scenes
        if (plans := _tried(report, scene))
    ]
    untried = [
        row for row in report.rows if row.stage.survey is not None and row.stage.survey.message
    ]
    if not scenes and not untried:
        return None
    # Without plans that another way found too: what costs the same and fares the same.
    groups = [
        list(
            {
                (f"{plan.price:.5g}", plan.alone.arrived, plan.weakest): plan for plan in plans
            }.values()
        )
        for *_, plans in scenes
    ]
    said = [
        sentence
        for sentence in (_cheaper(groups), _warm(groups), _feedback(groups), _weakest(groups))
        if sentence
    ]
    values = {
        "said": said,
        "scenes": [(scene, link, _plot(plans), plans) for scene, link, plans in scenes],
        "untried": untried,
    }
    return Section(
        "robustness",
        "What plans survive",
        "robustness.html#campaign",
        values,
        said=said[0] if said else "",
    )


def _tried(report: Report, scene: SceneRecord) -> list[Survivor]:
    """The plans of a scene that were tried, the cheapest first."""
    found = [
        Survivor(row, row.stage.cost, survey, survey.alone)
        for row in report.rows_of_scene(scene)
        if (survey := row.stage.survey) is not None
        and survey.alone is not None
        and row.stage.cost is not None
    ]
    return sorted(found, key=lambda plan: plan.price)


def _compared(pairs: Iterable[tuple[ShareRecord, ShareRecord]]) -> tuple[int, int, int]:
    """In how many pairs the first share is surely larger, is surely smaller, and may differ by chance."""
    signs = Counter(
        (one.interval[0] > other.interval[1]) - (one.interval[1] < other.interval[0])
        for one, other in pairs
    )
    return signs[1], signs[-1], signs[0]


def _answer(more: int, fewer: int, words: tuple[str, str]) -> str:
    """What the pairs say in which one arrives in more worlds, and in fewer. words: where nearly all say the first, the second."""
    if more + fewer < _ENOUGH:
        return "That cannot be told yet"
    return (
        words[0] if more > 2 * fewer else words[1] if fewer > 2 * more else "Now one, now the other"
    )


def _cheaper(groups: Iterable[list[Survivor]]) -> str:
    both = [pair for plans in groups for pair in combinations(plans, 2)]
    pairs = [
        (dear.alone, cheap.alone)
        for cheap, dear in both
        if dear.price - cheap.price > _SAME_COST * abs(dear.price)
    ]
    if not pairs:
        return ""
    more, fewer, open_ = _compared(pairs)
    return (
        f"Do cheaper plans break sooner? {_answer(more, fewer, ('Mostly', 'No, dearer ones do'))}: of {count(len(pairs), 'pair')} of plans of one scene "
        f"with different costs, the dearer one arrives in more worlds in {more}, in fewer in {fewer}; in the other {open_} the difference may be chance."
    )


def _warm(groups: Iterable[list[Survivor]]) -> str:
    pairs = []
    for plans in groups:
        exact = [plan for plan in plans if plan.row.stage.certificate is not None]
        warm, cold = (
            [plan.alone for plan in exact if (len(plan.row.methods) > 1) is begun]
            for begun in (True, False)
        )
        pairs += product(warm, cold)
    if not pairs:
        return ""
    more, fewer, _ = _compared(pairs)
    return (
        f"Do exact plans survive more that begin with another method's plan? {_answer(more, fewer, ('Yes', 'No, they survive less'))}: of "
        f"{count(len(pairs), 'pair')} on one scene the one with a warm start arrives in more worlds in {more}, in fewer in {fewer}; the median difference "
        f"is {100 * median(warm.share - cold.share for warm, cold in pairs):+.1f} points."
    )


def _feedback(groups: Iterable[list[Survivor]]) -> str:
    pairs = [
        (followed, plan.alone)
        for plans in groups
        for plan in plans
        if (followed := plan.survey.feedback) is not None
    ]
    if not pairs:
        return ""
    more, fewer, _ = _compared(pairs)
    after, before = (
        100 * median(share.share for share in shares) for shares in zip(*pairs, strict=True)
    )
    return (
        f"What does feedback buy? Of {count(len(pairs), 'plan')} it surely raises the share in {more} and lowers it in {fewer}; the median goes from "
        f"{before:.0f} % of the worlds to {after:.0f} %."
    )


def _weakest(groups: Iterable[list[Survivor]]) -> str:
    names = [
        f"{plan.survey.weakest} ({plan.row.run.scene.name})"
        for plans in groups
        for plan in plans
        if plan.survey.weakest
    ]
    first = [f"{name} in {times}" for name, times in Counter(names).most_common(3)]
    return f"Plans take least of {listing(first)} of {count(len(names), 'plan')}." if first else ""


def _plot(plans: list[Survivor]) -> Plot:
    """Cost against the share of worlds, inputs alone, with its interval."""
    prices = [plan.price for plan in plans]
    x = Axis.fitted("cost", "", prices, log=is_wide(prices), margin=0.06)
    plot = Plot(
        "Cost against the share of worlds in which a plan arrives",
        x,
        _SHARES,
        width=720,
        height=300,
        keys=keys("")[:-1],
    )
    for plan in plans:
        label, style = plan.row.label, style_of(plan.row)
        plot.line(
            f"{label}, interval",
            f"{style.split()[0]} soft",
            [plan.price] * 2,
            list(plan.alone.interval),
        )
        plot.point(
            plan.price,
            plan.alone.share,
            style,
            "circle",
            f"{label}: cost {cost(plan.price)}, {plan.alone.words}",
            plan.row.link,
        )
    return plot
