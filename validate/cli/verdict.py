"""Print a judged plan as `replay` and `show` do: the verdict first, then its score.

print_verdict(stage.verdict, stage.why, stage, cause_of_stage(stage))
print_score(stage)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from models.results.verdict import HOLD
from reports.judged import Cause, MetricView, deciding, questions_of
from validate.cli.table import print_table, say, short

if TYPE_CHECKING:
    from models.results.run import StageRecord
    from models.results.verdict import Metric


def print_verdict(verdict: str, why: str, stage: StageRecord | None, cause: Cause | None) -> None:
    """Print the verdict with its sentence, the metric that decided it, and the cause."""
    say(why if why.startswith(verdict) else f"{verdict}: {why}")
    metric = deciding(stage) if stage is not None else None
    if metric is not None:
        limit = f", limit {_amount(metric.limit, metric.unit)}"
        found = "not measured" if metric.value is None else _amount(metric.value, metric.unit)
        word = "closest to its limit" if verdict in HOLD else "decided by"
        say(
            f"{word}: {metric.name}, {found}{'' if metric.value is None else limit}: {metric.meaning}"
        )
    if cause is not None:
        say(f"cause: {cause.sentence.rstrip('.')}. {cause.advice}".rstrip())


def _amount(value: float | None, unit: str) -> str:
    return f"{short(value, '.3g')}{'' if unit == '1' else f' {unit}'}"


def print_score(stage: StageRecord) -> None:
    """Print questions and their answers, the metrics, and what was not asked."""
    views = questions_of(stage)
    if stage.questions:
        of = "the replay with feedback" if stage.is_tracked else "the inputs alone"
        rows = [
            ["" if question.number is None else str(question.number), question.value, answer]
            for question, answer in stage.questions
        ]
        click.echo()
        print_table(["", f"question, of {of}", "answer"], rows, ("",))
    click.echo()
    values = ["inputs alone", "with feedback"] if stage.is_followed else ["value"]
    rows = [
        row
        for question in views
        for view in question.metrics
        for row in _metric_rows(question.number, view, stage.is_tracked, len(values))
    ]
    meant = ("meaning", "reason of the limit")
    titles = ["question", "metric", *values, "+-", "unit", "limit", "", *meant]
    drop = (*meant[::-1], "+-", "question", "limit", "unit", *values[:-1])
    print_table(titles, rows, ("question", *values, "+-", "limit"), drop=drop)
    for sentence in stage.not_asked:
        say(f"not asked: {sentence}")


def _metric_rows(
    number: int | None, view: MetricView, tracked: bool, columns: int
) -> list[list[str]]:
    """Return the row of a metric, or none if the metric was not evaluated.

    tracked: whether the verdict is with feedback.
    """
    judged = (view.followed if tracked else view.alone) or view.metric
    if judged.value is None and judged.limit is None:
        return []
    known, asked = judged.value is not None, number is not None
    is_waived = known and asked and judged.limit is None and judged.reason
    # A default limit is in nominal sizes, which are unknown if nothing could be measured.
    limit = short(judged.limit, ".3g") if known or not judged.default else ""
    values = [
        short(None if metric is None else metric.value, ".5g")
        for metric in (view.alone, view.followed)[:columns]
    ]
    error = short(judged.error, ".1e") if judged.has_known_error else "unknown"
    own = error if judged.error else ""
    why = [judged.meaning, judged.reason] if known else [judged.reason, ""]
    cells = [own, judged.unit, "waived" if is_waived else limit, _against(judged)]
    return [[str(number) if asked else "", view.name, *values, *cells, *why]]


def _against(metric: Metric) -> str:
    """Compare a metric with its limit, in a word."""
    if metric.limit is None:
        return ""
    if metric.value is None:
        return "not measured"
    return "undecided" if metric.ok is None else "within" if metric.ok else "beyond"
