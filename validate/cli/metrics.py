"""The metrics of a plan as a table: what `replay` prints of a plan just judged, and `show` of a stored run.

print_metrics([(4, "replay_error", metric, None)], followed=False, tracked=False)
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeAlias

from validate.cli.table import print_table, short

if TYPE_CHECKING:
    from reports.records.record import MetricRecord
    from validate.judge.score import Metric


# The number of a question, the name, and the metric for the inputs alone and with feedback; None where there is none.
Row: TypeAlias = "tuple[int | None, str, Metric | MetricRecord | None, Metric | MetricRecord | None]"


def print_metrics(rows: Iterable[Row], *, followed: bool, tracked: bool) -> None:
    """followed: there is a replay with feedback too; tracked: the verdict is of that one."""
    values = ["inputs alone", "with feedback"] if followed else ["value"]
    lines = []
    for number, name, alone, with_feedback in rows:
        judged = (with_feedback if tracked else alone) or alone or with_feedback
        if judged is None or (judged.value is None and judged.limit is None):
            continue  # not asked, which a sentence says
        found = [None if metric is None else metric.value for metric in (alone, with_feedback)[: len(values)]]
        known, asked = judged.value is not None, number is not None
        limit = "waived" if known and asked and judged.limit is None and judged.reason else short(judged.limit, ".3g")
        unknown = judged.error is None or math.isinf(judged.error)
        own = "unknown" if unknown else short(judged.error, ".1e") if judged.error else ""
        cells = [*(short(value, ".5g") for value in found), own, judged.unit, limit, _against(judged)]
        why = [judged.meaning, judged.reason] if known else [judged.reason, ""]
        lines.append([str(number) if asked else "", name, *cells, *why])
    print_table(
        ["question", "metric", *values, "+-", "unit", "limit", "", "meaning", "reason of the limit"],
        lines,
        ("question", *values, "+-", "limit"),
        drop=("reason of the limit", "meaning", "+-", "question", "limit", "unit", *values[:-1]),
    )


def _against(metric: Metric | MetricRecord) -> str:
    """How it stands to its limit."""
    if metric.limit is None:
        return ""
    if metric.value is None:
        return "not measured"
    return "undecided" if metric.ok is None else "within" if metric.ok else "beyond"
