"""What plans that hold survive: for each scene cost against the share of perturbed worlds in which a plan arrives, and what can be concluded over all of them.

A conclusion counts pairs of plans of one scene whose shares differ by more than chance: their intervals of 95 % have nothing in common.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations, product
from statistics import median

from reports.pages.pareto import keys, style_of
from reports.pages.section import Report, Section
from reports.plots.axis import Axis
from reports.plots.figure import Plot
from reports.records.record import SceneRecord, ShareRecord, SurveyRecord
from reports.rows import Row
from reports.wording import cost, count, listing, number

# Costs that differ by less, relatively, are the same.
_SAME_COST = 1e-3
# Fewer pairs that differ by more than chance say nothing.
_ENOUGH = 5
# Costs that span more than this are drawn on a logarithmic axis.
_WIDE = 20.0


@dataclass(frozen=True)
class Survivor:
    """A plan that was tried: its row, what it costs, and how it fares."""

    row: Row
    price: float
    survey: SurveyRecord
    alone: ShareRecord

    @property
    def weakest(self) -> str:
        """Such as `c by -0.0833 N s/m, 0.83 of its size`; empty where it takes all that was tried."""
        found = self.survey
        if found.sizes is None or found.amount is None:
            return ""
        return (
            f"{found.weakest} by {found.amount:+.3g}{'' if found.unit == '1' else f' {found.unit}'}, {number(found.sizes, 2)} of its size"
        )


def build(report: Report) -> Section | None:
    """The section, or None where no plan was tried."""
    scenes = [(scene, report.scene_link(scene), plans) for scene in report.scenes if (plans := _tried(report, scene))]
    untried = [row for row in report.rows if row.stage.survey is not None and row.stage.survey.message]
    if not scenes and not untried:
        return None
    groups = [_different(plans) for _, _, plans in scenes]
    said = [sentence for sentence in (_cheaper(groups), _warm(groups), _feedback(groups), _weakest(groups)) if sentence]
    values = {"said": said, "scenes": [(scene, link, _plot(plans), plans) for scene, link, plans in scenes], "untried": untried}
    return Section("robustness", "What plans survive", "robustness.html#campaign", values, said=said[0] if said else "")


def _tried(report: Report, scene: SceneRecord) -> list[Survivor]:
    """The plans of a scene that were tried, the cheapest first."""
    found = [
        Survivor(row, row.stage.cost, survey, survey.alone)
        for row in report.rows_of_scene(scene)
        if (survey := row.stage.survey) is not None and survey.alone is not None and row.stage.cost is not None
    ]
    return sorted(found, key=lambda plan: plan.price)


def _different(plans: Iterable[Survivor]) -> list[Survivor]:
    """Without plans that another way found too: what costs the same and fares the same."""
    return list({(f"{plan.price:.5g}", plan.alone.arrived, plan.weakest): plan for plan in plans}.values())


def _apart(one: ShareRecord, other: ShareRecord) -> int:
    """1 where the first share is surely larger, -1 where surely smaller, 0 where that may be chance."""
    return (one.interval[0] > other.interval[1]) - (one.interval[1] < other.interval[0])


def _cheaper(groups: Iterable[list[Survivor]]) -> str:
    pairs = [
        (dear, cheap)
        for plans in groups
        for cheap, dear in combinations(plans, 2)
        if dear.price - cheap.price > _SAME_COST * abs(dear.price)
    ]
    signs = Counter(_apart(dear.alone, cheap.alone) for dear, cheap in pairs)
    if not pairs:
        return ""
    return (
        f"Do cheaper plans break sooner? {_answer(signs[1], signs[-1], ('Mostly', 'No, dearer ones do'))}: of {count(len(pairs), 'pair')} of plans of one scene with different costs, the dearer one arrives in more worlds in {signs[1]}, "
        f"in fewer in {signs[-1]}; in the other {signs[0]} the difference may be chance."
    )


def _answer(more: int, fewer: int, words: tuple[str, str]) -> str:
    """What the pairs say in which one arrives in more worlds, and in fewer. words: where nearly all say the first, the second."""
    if more + fewer < _ENOUGH:
        return "That cannot be told yet"
    return words[0] if more > 2 * fewer else words[1] if fewer > 2 * more else "Now one, now the other"


def _warm(groups: Iterable[list[Survivor]]) -> str:
    pairs = []
    for plans in groups:
        exact = [plan for plan in plans if plan.row.stage.certificate is not None]
        pairs += product([plan for plan in exact if len(plan.row.methods) > 1], [plan for plan in exact if len(plan.row.methods) == 1])
    if not pairs:
        return ""
    signs = Counter(_apart(warm.alone, cold.alone) for warm, cold in pairs)
    return (
        f"Do exact plans survive more that begin with another method's plan? {_answer(signs[1], signs[-1], ('Yes', 'No, they survive less'))}: of {count(len(pairs), 'pair')} on one scene the one with a warm start arrives in more worlds in {signs[1]}, in fewer in "
        f"{signs[-1]}; the median difference is {100 * median(warm.alone.share - cold.alone.share for warm, cold in pairs):+.1f} points."
    )


def _feedback(groups: Iterable[list[Survivor]]) -> str:
    pairs = [(plan.alone, followed) for plans in groups for plan in plans if (followed := plan.survey.feedback) is not None]
    if not pairs:
        return ""
    signs = Counter(_apart(followed, alone) for alone, followed in pairs)
    before, after = (100 * median(shares) for shares in zip(*((alone.share, followed.share) for alone, followed in pairs), strict=True))
    return f"What does feedback buy? Of {count(len(pairs), 'plan')} it surely raises the share in {signs[1]} and lowers it in {signs[-1]}; the median goes from {before:.0f} % of the worlds to {after:.0f} %."


def _weakest(groups: Iterable[list[Survivor]]) -> str:
    names = [f"{plan.survey.weakest} ({plan.row.run.scene.name})" for plans in groups for plan in plans if plan.survey.weakest]
    first = Counter(names).most_common(3)
    if not first:
        return ""
    return f"Plans take least of {listing([f'{name} in {times}' for name, times in first])} of {count(len(names), 'plan')}."


def _plot(plans: list[Survivor]) -> Plot:
    """Cost against the share of worlds, inputs alone, with its interval."""
    prices = [plan.price for plan in plans]
    x = Axis.fitted("cost", "", prices, log=min(prices) > 0 and max(prices) > _WIDE * min(prices), margin=0.06)
    plot = Plot(
        "Cost against the share of worlds in which a plan arrives",
        x,
        Axis.fitted("share", "", [0.0, 1.0], zero=True),
        width=720,
        height=300,
    )
    for plan in plans:
        plot.line(f"{plan.row.label}, interval", f"{style_of(plan.row).split()[0]} soft", [plan.price] * 2, list(plan.alone.interval))
        plot.point(
            plan.price,
            plan.alone.share,
            style_of(plan.row),
            "circle",
            f"{plan.row.label}: cost {cost(plan.price)}, {plan.alone.words}",
            plan.row.link,
        )
    plot.keys = keys("")[:-1]
    return plot
