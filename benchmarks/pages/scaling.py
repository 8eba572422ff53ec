"""Growth with the size of the problem: CPU time and memory of each stage over n T, with the exponents fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace

from benchmarks.pages.chart import chart
from benchmarks.records import AnyRecord, ScalingRecord, ScalingRow, ScalingStage
from reports.pages.section import Section
from reports.plots import Plot
from reports.wording import error, listing, spaced

# What counts as about linear: in time, and in memory.
_LINEAR = {"time": 1.15, "memory": 1.05}
# Below this [MiB] a growth of the process is its own bookkeeping.
_LEAST_MEMORY = 1.0


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where nothing was measured."""
    views = [_view(record) for record in records if isinstance(record, ScalingRecord)]
    return (
        Section("scaling", "Growth with size", "scaling.html", {"views": views}) if views else None
    )


def _view(record: ScalingRecord) -> SimpleNamespace:
    time = _plot(record, "CPU time over n T", "CPU time", "s", lambda row: row.cpu_s)
    memory = _plot(
        record,
        "Memory over n T",
        "memory",
        "MiB",
        lambda row: row.memory_mib if (row.memory_mib or 0) >= _LEAST_MEMORY else None,
    )
    sentences = [_sentence(stage) for stage in record.stages]
    return SimpleNamespace(
        plots=[plot for plot in (time, memory) if plot is not None],
        sentences=sentences,
        stages=record.stages,
    )


def _plot(
    record: ScalingRecord,
    title: str,
    what: str,
    unit: str,
    value: Callable[[ScalingRow], float | None],
) -> Plot | None:
    series = {
        spaced(stage.name): [
            (
                float(row.n * row.steps),
                y,
                f"{spaced(stage.name)}, n = {row.n}, T = {row.steps}: {error(y)} {unit}, {spaced(row.outcome)}",
            )
            for row in stage.rows
            if (y := value(row)) is not None and y > 0
        ]
        for stage in record.stages
    }
    plot = chart(title, ("bodies times steps, n T", ""), (what, unit), series)
    if plot is not None:
        plot.words = "Each point is one size; points on a line of slope one grow linearly."
    return plot


def _sentence(stage: ScalingStage) -> str:
    parts = []
    for kind, exponent in (("time", stage.time_exponent), ("memory", stage.memory_exponent)):
        if exponent is not None:
            parts.append(
                f"{kind} as (n T) to the {exponent:.2f}, {'about linear' if exponent <= _LINEAR[kind] else 'faster than linear'}"
            )
    words = (
        f"{spaced(stage.name)}: grows in {listing(parts)}."
        if parts
        else f"{spaced(stage.name)}: too few sizes for an exponent."
    )
    if stage.iteration_exponent is not None and stage.iteration_exponent != stage.time_exponent:
        words += f" An iteration: to the {stage.iteration_exponent:.2f}."
    unsolved = [
        f"n = {row.n}, T = {row.steps} ({spaced(row.outcome)})"
        for row in stage.rows
        if row.outcome not in ("solved", "ok")
    ]
    return words + (f" Not solved: {listing(unsolved)}." if unsolved else "")
