"""The three findings of a campaign, as sentences for the report and the terminal.

three_findings(runs) -> ("0 of 54 relaxed plans hold; ..", "29 of 43 runs that end with exact
                         contact hold.", "Try first softplus_dc+strict, ..")
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from models.results.run import RunRecord, StageRecord
from models.results.verdict import HOLD
from reports.foreign import answers, planned, sentence
from reports.rows import rows_of
from reports.wording import count, error, listing, number, seconds, unit

# Verdicts of runs without questions.
NOT_ASKED = ("not applicable", "consistent")
# Smallest number of scenes on which a pipeline must hold to be recommended.
ENOUGH = 3
# Largest ratio to the best cost that counts as equal.
_BEST = 1.005


@dataclass(frozen=True)
class Standing:
    """A pipeline over its scenes: number on which it holds, median cost ratio and CPU time [s]."""

    pipeline: str
    holds: int
    able: int
    ratio: float | None
    cpu: float | None

    @property
    def rank(self) -> tuple[float, float, float]:
        """Return the sort key: scenes on which it holds, then cost, then time."""
        unknown = float("inf")
        ratio = unknown if self.ratio is None else 1.0 if self.is_best else self.ratio
        return -self.holds, ratio, unknown if self.cpu is None else self.cpu

    @property
    def is_best(self) -> bool:
        """Return whether its cost counts as the best."""
        return self.ratio is not None and self.ratio < _BEST


def three_findings(runs: Sequence[RunRecord]) -> tuple[str, ...]:
    """Return sentences on foreign, relaxed and exact plans, and the pipeline to try first."""
    ours = planned(runs)
    found = (sentence(answers(runs)), _relaxed(ours), _exact(ours), _first(standings(ours)))
    return tuple(said for said in found if said)


def least_costs(runs: Iterable[RunRecord]) -> dict[str, float]:
    """Return the cost of the cheapest plan that holds, by scene."""
    least: dict[str, float] = {}
    for run in runs:
        price = run.cost
        if run.verdict in HOLD and price is not None:
            least[run.scene.name] = min(price, least.get(run.scene.name, price))
    return least


def cost_ratio(run: RunRecord, least: Mapping[str, float]) -> float | None:
    """Return the cost over the cheapest plan's; None if the run does not hold, or that is 0."""
    price, best = run.cost, least.get(run.scene.name, 0.0)
    return price / best if run.verdict in HOLD and price is not None and best > 0.0 else None


def standings(runs: Sequence[RunRecord]) -> list[Standing]:
    """Return the pipelines, the best first; those without a scene are left out."""
    least, result = least_costs(runs), []
    for name in dict.fromkeys(run.pipeline for run in runs):
        mine = [run for run in runs if run.pipeline == name and run.verdict not in NOT_ASKED]
        holding = [run for run in mine if run.verdict in HOLD]
        ratios = [ratio for run in holding if (ratio := cost_ratio(run, least)) is not None]
        if mine:
            cpu = median(run.solving_cpu for run in holding) if holding else None
            result.append(
                Standing(name, len(holding), len(mine), median(ratios) if ratios else None, cpu)
            )
    return sorted(result, key=lambda standing: standing.rank)


def _relaxed(runs: Sequence[RunRecord]) -> str:
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
    sentence = f"{holding} of {len(plans)} relaxed plans {'holds' if holding == 1 else 'hold'}"
    missed = [words for part in ("position", "velocity") if (words := _missed(violating, part))]
    return (
        f"{sentence}; those that violate end {listing(missed)} from the goal (medians after the replay)."
        if missed
        else f"{sentence}."
    )


def _missed(stages: Sequence[StageRecord], part: str) -> str:
    """Return the median over judged replays, as `0.42 m or rad`, or ""."""
    metrics = [
        metric
        for stage in stages
        if (metric := stage.judged(f"replay_terminal_{part}_error")) is not None
    ]
    values = [metric.value for metric in metrics if metric.value is not None]
    units = " or ".join(
        sorted(
            {
                unit(metric.unit)
                for metric in metrics
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
    ending = [run for run in runs if run.must_hold]
    judged = [run for run in ending if run.verdict not in NOT_ASKED]
    if not judged:
        return ""
    holding, without = (
        [run for run in judged if run.verdict in HOLD],
        sum(run.verdict == "no plan" for run in judged),
    )
    followed = sum(run.verdict == "holds with feedback" for run in holding)
    beside = [
        f"{followed} of them with feedback" if followed else "",
        f"{without} found no plan" if without else "",
    ]
    aside, details = len(ending) - len(judged), "; ".join(part for part in beside if part)
    sentence = f"{len(holding)} of {count(len(judged), 'run')} that {'ends' if len(judged) == 1 else 'end'} with exact contact"
    sentence += f" {'holds' if len(judged) == 1 else 'hold'}{f' ({details})' if details else ''}."
    return sentence + (
        f" {aside} more {'does not apply to its' if aside == 1 else 'do not apply to their'} scene."
        if aside
        else ""
    )


def _first(ranked: Sequence[Standing]) -> str:
    good = [standing for standing in ranked if standing.holds]
    if not good:
        return "No pipeline found a plan that holds." if ranked else ""
    best = good[0]
    enough = [standing for standing in good if standing.holds >= min(ENOUGH, best.holds)]
    fast = min(enough, key=lambda standing: standing.rank[2])
    equal = [standing.pipeline for standing in good if standing.rank == best.rank]
    sentence = f"Try first {' or '.join(equal)}: {_standing(best)}."
    return (
        sentence
        if fast.pipeline in equal
        else f"{sentence} Fastest: {fast.pipeline}, {_standing(fast)}."
    )


def _standing(standing: Standing) -> str:
    phrase = f"holds on {standing.holds} of {count(standing.able, 'scene')}"
    if standing.ratio is not None:
        phrase += (
            ", at the best cost"
            if standing.is_best
            else f", {number(standing.ratio, 3)} times the best cost"
        )
    return phrase + (f", {seconds(standing.cpu)} CPU s" if standing.cpu is not None else "")
