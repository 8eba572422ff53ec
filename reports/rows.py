"""Rows of the tables: each stage once, although pipelines share their first stages.

softplus_dc+strict and softplus_dc+relu_gd share softplus_dc at 1e-3, 1e-5, 1e-7: five rows.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from models.results.run import RunRecord, SceneRecord, StageRecord
from models.results.verdict import HOLD
from reports.judged import end_of
from reports.paper import TABLE_1, PaperRow
from reports.wording import small


@dataclass(frozen=True)
class Row:
    """A stage and the stages before it, with a link to its run."""

    run: RunRecord
    stage: StageRecord
    chain: tuple[StageRecord, ...]
    link: str
    # Another row has the same methods and eps, but other options: only the pipeline differs.
    twin: bool = False

    @property
    def methods(self) -> tuple[str, ...]:
        """Return the methods of the chain, without repetitions."""
        names = [stage.method for stage in self.chain]
        return tuple(
            name for place, name in enumerate(names) if place == 0 or names[place - 1] != name
        )

    @property
    def name(self) -> str:
        """Return the method and its eps: softplus_dc ε = 10⁻⁵."""
        return self.stage.method + (f" ε = {small(self.stage.eps)}" if self.stage.eps else "")

    @property
    def label(self) -> str:
        """Return the name with the stages before: strict_lcp after softplus_dc."""
        before = self.methods[:-1]
        after = f" after {', '.join(before)}" if before else ""
        return f"{self.name}{after}" + (
            f" ({self.run.pipeline})"
            if self.twin and self.run.pipeline != self.stage.method
            else ""
        )

    @property
    def paper_total(self) -> float | None:
        """Return the paper's seconds including the stages before."""
        times = [stage.paper.get("time") for stage in self.chain]
        return (
            None
            if any(time is None for time in times)
            else sum(time for time in times if time is not None)
        )

    def metric(self, name: str) -> float | None:
        """Return a metric's value, of the judged replay."""
        metric = self.stage.judged(name)
        return metric.value if metric is not None else None

    @property
    def ends(self) -> str:
        """Return the distance of the judged replay's end from the goal, or ""."""
        return end_of(self.stage, self.run.scene)

    @property
    def holds(self) -> bool:
        """Return whether the plan holds, with or without feedback."""
        return self.stage.verdict in HOLD

    @property
    def named(self) -> str:
        """Return the label, with a note if the plan holds only with feedback."""
        return self.label + (
            ", which holds with feedback" if self.stage.verdict == "holds with feedback" else ""
        )

    @property
    def cost_difference(self) -> float | None:
        """Return the relative difference of our cost from the paper's."""
        theirs = self.stage.paper.get("cost")
        return None if self.stage.cost is None or not theirs else self.stage.cost / theirs - 1


def known_cost(scene: SceneRecord) -> tuple[str, float] | None:
    """Return name and value of the known cost, or None."""
    return next(
        (
            (item.name, item.value)
            for item in scene.answers
            if "cost" in item.name and item.value is not None
        ),
        None,
    )


def rows_of(runs: tuple[RunRecord, ...], link: Callable[[RunRecord], str]) -> list[Row]:
    """Return all rows in the order of the paper's table; link: from a run to its page."""
    heads = {head: place for place, head in enumerate(dict.fromkeys(_head(run) for run in runs))}
    rows: dict[str, Row] = {}
    for run in sorted(runs, key=lambda run: heads[_head(run)]):
        identity = [run.scene.name]
        for place, stage in enumerate(run.stages):
            identity.append(json.dumps([stage.method, stage.eps, stage.options], sort_keys=True))
            key = "\n".join(identity)
            if key not in rows:
                chain = run.stages[: place + 1]
                rows[key] = Row(run, stage, chain, link(run))
    labels = Counter((row.run.scene.name, row.label) for row in rows.values())
    return [
        replace(row, twin=not row.stage.paper and labels[row.run.scene.name, row.label] > 1)
        for row in rows.values()
    ]


def _head(run: RunRecord) -> tuple[str, str]:
    return run.scene.name, run.stages[0].method if run.stages else run.pipeline


def lacking(rows: list[Row]) -> list[PaperRow]:
    """Return rows of the paper's table without a stage of ours, if we have any of them."""
    ours = {(row.methods, row.stage.eps) for row in rows if row.stage.paper}
    return [row for row in TABLE_1 if ours and (row.methods, row.eps) not in ours]
