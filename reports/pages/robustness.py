"""Robustness of one plan (`validate robust`), and of a campaign's plans by scene.

Conclusions count pairs of plans of a scene with disjoint 95 % intervals.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import combinations, product
from statistics import median
from typing import NamedTuple

from models.results.robustness import RobustnessRecord, Share, Survey
from models.results.run import SceneRecord
from reports.pages.pareto import keys, style_of
from reports.pages.section import Report, Section
from reports.plots import Axis, Plot, is_wide
from reports.render import render_sections
from reports.rows import Row
from reports.wording import cost, count, listing, number

_SHARES = Axis.fitted("share", "", [0.0, 1.0], zero=True)
# Relative difference of equal costs.
_SAME_COST = 1e-3
# Smallest number of significant pairs for a conclusion.
_ENOUGH = 5


def of_plan(record: RobustnessRecord) -> Section:
    """Return the section of one plan."""
    values = {
        "record": record,
        "failures": sorted(record.failures, key=lambda item: (item.sizes is None, item.sizes)),
    }
    return Section("robustness", "How much it can take", "robustness.html#plan", values)


def page_of_plan(record: RobustnessRecord, plan: str) -> str:
    """Return the page of one plan; plan: its name."""
    title = f"How much {plan} can take on {record.scene}"
    return render_sections([of_plan(record)], title=title, lead=record.summary)


class Survivor(NamedTuple):
    """A tried plan: row, cost, and results."""

    row: Row
    price: float
    survey: Survey
    alone: Share

    @property
    def weakest(self) -> str:
        """Return text such as `c by -0.0833 N s/m, 0.83 of its size`, "" without a failure."""
        survey = self.survey
        if survey.sizes is None or survey.amount is None:
            return ""
        of = "" if survey.unit == "1" else f" {survey.unit}"
        return (
            f"{survey.weakest} by {survey.amount:+.3g}{of}, {number(survey.sizes, 2)} of its size"
        )


def build(report: Report) -> Section | None:
    """Return the section of a campaign, None if no plan was tried."""
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
    # Without duplicates of equal cost and result.
    groups = [
        list(
            {
                (f"{plan.price:.5g}", plan.alone.arrived, plan.weakest): plan for plan in plans
            }.values()
        )
        for *_, plans in scenes
    ]
    sentences = [
        sentence
        for sentence in (_cheaper(groups), _warm(groups), _feedback(groups), _weakest(groups))
        if sentence
    ]
    values = {
        "said": sentences,
        "scenes": [(scene, link, _plot(plans), plans) for scene, link, plans in scenes],
        "untried": untried,
    }
    return Section(
        "robustness",
        "What plans survive",
        "robustness.html#campaign",
        values,
        said=sentences[0] if sentences else "",
    )


def _tried(report: Report, scene: SceneRecord) -> list[Survivor]:
    plans = [
        Survivor(row, row.stage.cost, survey, survey.alone)
        for row in report.rows_of_scene(scene)
        if (survey := row.stage.survey) is not None
        and survey.alone is not None
        and row.stage.cost is not None
    ]
    return sorted(plans, key=lambda plan: plan.price)


def _compared(pairs: Iterable[tuple[Share, Share]]) -> tuple[int, int, int]:
    signs = Counter(
        (one.interval[0] > other.interval[1]) - (one.interval[1] < other.interval[0])
        for one, other in pairs
    )
    return signs[1], signs[-1], signs[0]


def _answer(more: int, fewer: int, words: tuple[str, str]) -> str:
    """Return a conclusion from these numbers; words: if the first or the second dominates."""
    if more + fewer < _ENOUGH:
        return "That cannot be told yet"
    return words[0] if more > 2 * fewer else words[1] if fewer > 2 * more else "Both occur"


def _cheaper(groups: Iterable[list[Survivor]]) -> str:
    both = [pair for plans in groups for pair in combinations(plans, 2)]
    pairs = [
        (expensive.alone, cheap.alone)
        for cheap, expensive in both
        if expensive.price - cheap.price > _SAME_COST * abs(expensive.price)
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
        f"What does feedback gain? Of {count(len(pairs), 'plan')} it surely raises the share in {more} and lowers it in {fewer}; the median goes from "
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
    return (
        f"Plans are weakest against {listing(first)} of {count(len(names), 'plan')}."
        if first
        else ""
    )


def _plot(plans: list[Survivor]) -> Plot:
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
