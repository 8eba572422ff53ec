"""The three findings of a campaign, in sentences made from its records.

The report's first screen and the terminal tell the same.

three_findings(runs) -> ("0 of 54 relaxed plans hold; ..", "29 of 43 runs that end with exact
contact hold.", "Try first softplus_dc+strict, ..")
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from reports.foreign import answers, planned, sentence
from reports.records.record import HOLD, RunRecord, StageRecord
from reports.rows import rows_of
from reports.wording import count, error, listing, number, seconds, unit

# Verdicts of runs of which nothing is asked.
NOT_ASKED = ("not applicable", "consistent")
# A pipeline is recommended by its medians only where it holds on so many scenes.
ENOUGH = 3
# Up to which ratio a cost is called the best: what is called the same decides nothing.
_BEST = 1.005


@dataclass(frozen=True)
class Standing:
    """A pipeline over the scenes it applies to: on how many its plan holds, and medians over those [of the best cost, CPU s]."""

    pipeline: str
    holds: int
    able: int
    ratio: float | None
    cpu: float | None

    @property
    def rank(self) -> tuple[float, float, float]:
        """The better the smaller: scenes on which it holds, then cost, then time."""
        unknown = float("inf")
        ratio = unknown if self.ratio is None else 1.0 if self.is_best else self.ratio
        return -self.holds, ratio, unknown if self.cpu is None else self.cpu

    @property
    def is_best(self) -> bool:
        """Whether its cost is called the best."""
        return self.ratio is not None and self.ratio < _BEST


def three_findings(runs: Sequence[RunRecord]) -> tuple[str, ...]:
    """Do relaxed plans hold, do exact ones, which pipeline to try first; before these, foreign plans.

    Without a sentence where there is nothing to say it of.
    """
    ours = planned(runs)
    found = (sentence(answers(runs)), _relaxed(ours), _exact(ours), _first(standings(ours)))
    return tuple(said for said in found if said)


def least_costs(runs: Iterable[RunRecord]) -> dict[str, float]:
    """Scene -> cost of its cheapest plan that holds."""
    least: dict[str, float] = {}
    for run in runs:
        price = run.cost
        if run.verdict in HOLD and price is not None:
            least[run.scene.name] = min(price, least.get(run.scene.name, price))
    return least


def cost_ratio(run: RunRecord, least: Mapping[str, float]) -> float | None:
    """Cost over that of the cheapest plan that holds on the scene.

    None where the run does not hold, or the cheapest costs nothing.
    """
    price, best = run.cost, least.get(run.scene.name, 0.0)
    return price / best if run.verdict in HOLD and price is not None and best > 0.0 else None


def standings(runs: Sequence[RunRecord]) -> list[Standing]:
    """The best first; equal ones in the order of the campaign.

    Pipelines that apply nowhere are left out.
    """
    least, found = least_costs(runs), []
    for name in dict.fromkeys(run.pipeline for run in runs):
        mine = [run for run in runs if run.pipeline == name and run.verdict not in NOT_ASKED]
        holding = [run for run in mine if run.verdict in HOLD]
        ratios = [ratio for run in holding if (ratio := cost_ratio(run, least)) is not None]
        if mine:
            cpu = median(run.solving_cpu for run in holding) if holding else None
            found.append(
                Standing(name, len(holding), len(mine), median(ratios) if ratios else None, cpu)
            )
    return sorted(found, key=lambda standing: standing.rank)


def _relaxed(runs: Sequence[RunRecord]) -> str:
    """Whether relaxed plans hold."""
    rows = rows_of(tuple(runs), lambda run: "")
    plans = [
        row.stage
        for row in rows
        if row.stage.kind == "indirect" and row.stage.verdict not in ("no plan", *NOT_ASKED)
    ]
    if not plans:
        return ""
    holding, violating = (
        sum(stage.verdict in HOLD for stage in plans),
        [stage for stage in plans if stage.verdict == "violates"],
    )
    said = f"{holding} of {len(plans)} relaxed plans {'holds' if holding == 1 else 'hold'}"
    missed = [words for part in ("position", "velocity") if (words := _missed(violating, part))]
    return (
        f"{said}; those that violate end {listing(missed)} from the goal (medians after the replay)."
        if missed
        else f"{said}."
    )


def _missed(stages: Sequence[StageRecord], part: str) -> str:
    """`0.42 m or rad`: the median over the judged replays; empty where none was measured."""
    found = [
        metric
        for stage in stages
        if (metric := stage.judged(f"replay_terminal_{part}_error")) is not None
    ]
    values = [metric.value for metric in found if metric.value is not None]
    units = " or ".join(
        sorted(
            {
                unit(metric.unit)
                for metric in found
                if metric.value is not None and "," not in metric.unit
            }
            - {""}
        )
    )
    return (
        f"{error(median(values))} {units}".strip() + (f" ({part})" if not units else "")
        if values
        else ""
    )


def _exact(runs: Sequence[RunRecord]) -> str:
    """Whether exact ones do."""
    ending = [run for run in runs if run.must_hold]
    asked = [run for run in ending if run.verdict not in NOT_ASKED]
    if not asked:
        return ""
    holding, without = (
        [run for run in asked if run.verdict in HOLD],
        sum(run.verdict == "no plan" for run in asked),
    )
    followed = sum(run.verdict == "holds with feedback" for run in holding)
    beside = [
        f"{followed} of them with feedback" if followed else "",
        f"{without} found no plan" if without else "",
    ]
    aside, told = len(ending) - len(asked), "; ".join(part for part in beside if part)
    said = f"{len(holding)} of {count(len(asked), 'run')} that {'ends' if len(asked) == 1 else 'end'} with exact contact"
    said += f" {'holds' if len(asked) == 1 else 'hold'}{f' ({told})' if told else ''}."
    return said + (
        f" {aside} more {'does not apply to its' if aside == 1 else 'do not apply to their'} scene."
        if aside
        else ""
    )


def _first(ranked: Sequence[Standing]) -> str:
    """Which pipeline to try first."""
    good = [standing for standing in ranked if standing.holds]
    if not good:
        return "No pipeline found a plan that holds." if ranked else ""
    best = good[0]
    enough = [standing for standing in good if standing.holds >= min(ENOUGH, best.holds)]
    fast = min(enough, key=lambda standing: standing.rank[2])
    equal = [standing.pipeline for standing in good if standing.rank == best.rank]
    said = f"Try first {' or '.join(equal)}: {_standing(best)}."
    return (
        said if fast.pipeline in equal else f"{said} Fastest: {fast.pipeline}, {_standing(fast)}."
    )


def _standing(standing: Standing) -> str:
    said = f"holds on {standing.holds} of {count(standing.able, 'scene')}"
    if standing.ratio is not None:
        said += (
            ", at the best cost"
            if standing.is_best
            else f", {number(standing.ratio, 3)} times the best cost"
        )
    return said + (f", {seconds(standing.cpu)} CPU s" if standing.cpu is not None else "")
