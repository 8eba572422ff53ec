"""Checks of a campaign: FMUs with all their checks, and stress cases with metrics and plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from models.results.check import AxisRecord, ChartRecord, CheckRecord
from models.results.verdict import Metric
from reports.pages.section import Report, Section
from reports.plots import Axis, Key, Plot
from reports.wording import Sign, capital, count, listing, number, spaced

FMU = "FMU"
STATUSES = ("passed", "failed", "not offered")
# Statuses shown only if they occur.
RARE = ("advice", "waived")


class FmuView(NamedTuple):
    """One check; ended: how it ended if it did not pass."""

    record: CheckRecord
    name: str
    version: str
    anchor: str
    ended: str


def fmus(report: Report) -> Section | None:
    """Return the section, None without FMUs."""
    records = [record for record in report.stored.checks if record.kind == FMU]
    return fmus_of(records) if records else None


def fmus_of(records: Sequence[CheckRecord]) -> Section:
    """Return the section of checks of FMUs; external ones include how they were made."""
    views = [_view(record, place) for place, record in enumerate(records)]
    sentence = _sentence(views)
    ours = any(record.scene for record in records)
    # With several FMUs claims are listed once, instead of in every table.
    rows = [row for record in records if record.fmu is not None for row in record.fmu.rows]
    claims = list(dict.fromkeys((row.name, row.claim) for row in rows)) if len(views) > 1 else []
    statuses = (
        *STATUSES,
        *(status for status in RARE if any(row.status == status for row in rows)),
    )
    values = {
        "views": views,
        "statuses": statuses,
        "sentence": sentence,
        "ours": ours,
        "claims": claims,
        "origin": records[0].provenance,
    }
    return Section("fmus", "FMUs under the check", "checks.html#fmus", values, said=sentence)


def _view(record: CheckRecord, place: int) -> FmuView:
    ended = (
        ""
        if record.passed
        else "failed"
        if record.outcome == "answered"
        else record.outcome.replace("_", " ")
    )
    name, _, version = record.name.partition(", FMI ")
    return FmuView(
        record,
        record.scene or name,
        record.fmu.version if record.fmu else version,
        f"fmu-{place + 1}",
        ended,
    )


def _sentence(views: list[FmuView]) -> str:
    scenes = {view.record.scene for view in views} - {None}
    of_scenes = f" of {count(len(scenes), 'scene')}" if scenes else ""
    versions = listing(sorted({view.version for view in views if view.version}))
    looked = [view.record.fmu for view in views if view.record.fmu is not None]
    numbers = {status: sum(fmu.count(status) for fmu in looked) for status in (*STATUSES, *RARE)}
    counts = ", ".join(
        f"{number} {status}" for status, number in numbers.items() if number or status in STATUSES
    )
    bad = sum(not view.record.passed for view in views)
    result = f"{bad} of them {'does' if bad == 1 else 'do'} not pass" if bad else "every one passes"
    cost = sum(view.record.cpu_seconds for view in views)
    return f"{count(len(views), 'FMU')}{of_scenes} in FMI {versions}: {result}. Checks: {counts}; {cost:.0f} CPU seconds."


STRESS_CASE = "stress case"
PASS = Sign("pass", "✓", "holds", "every metric is within its limit")
FAIL = Sign("fail", "✗", "violates", "a metric is beyond its limit")
LOST = Sign("no answer", "○", "noplan", "the case ended without an answer")
_STYLES = (
    ("c0", "circle"),
    ("c1", "square"),
    ("c2", "diamond"),
    ("c3", "triangle"),
    ("c4", "circle"),
    ("c5", "square"),
)
# Figures of a case in the table, failing ones first.
_IN_TABLE = 2
# Largest number of points drawn with markers.
_MARKED = 60
# Share of a logarithmic axis left free below for zeros.
_BELOW = 0.08


class CaseRow(NamedTuple):
    """One case, with number and title from its name; decisive: metrics for the table."""

    anchor: str
    number: str
    title: str
    record: CheckRecord
    sign: Sign
    happened: str
    decisive: tuple[Metric, ...]
    plots: tuple[Plot, ...]


def stress_cases(report: Report) -> Section | None:
    """Return the section, None without stress cases."""
    records = sorted(
        (item for item in report.stored.checks if item.kind == STRESS_CASE),
        key=lambda item: item.name,
    )
    if not records:
        return None
    rows = [_row(record) for record in records]
    failed = [row for row in rows if row.sign is not PASS]
    passed = f"{len(rows) - len(failed)} of {count(len(rows), 'stress case')} {'passes' if len(rows) == 1 else 'pass'}"
    spent = sum(row.record.cpu_seconds for row in rows)
    values = {
        "rows": rows,
        "passed": passed,
        "failed": failed,
        "marks": {True: PASS, False: FAIL},
        "seconds": spent,
    }
    sentence = f"{passed}: stiff, grazing, simultaneous and other contact on which solvers go wrong, each with its metrics and plots."
    return Section(
        "stress-cases", "Stress cases", "checks.html#stress_cases", values, said=sentence
    )


def _row(record: CheckRecord) -> CaseRow:
    place, _, title = record.name.partition(" ")
    sign = PASS if record.passed else FAIL if record.outcome == "answered" else LOST
    judged = [figure for figure in record.figures if figure.ok is not None]
    return CaseRow(
        anchor=f"stress-case-{place}",
        number=place.lstrip("0") or place,
        title=title or record.name,
        record=record,
        sign=sign,
        happened=record.found
        or record.message
        or f"It ended as {spaced(record.outcome)}, without a message.",
        decisive=tuple(sorted(judged, key=lambda figure: figure.ok is not False)[:_IN_TABLE]),
        plots=tuple(
            plot_of(chart) for chart in record.charts if any(series.x for series in chart.series)
        ),
    )


def plot_of(chart: ChartRecord) -> Plot:
    """Return the plot of a chart."""
    across = _axis(chart.x, [x for series in chart.series for x in series.x])
    up = _axis(
        chart.y,
        [y for series in chart.series for y in series.y]
        + ([] if chart.level is None else [chart.level]),
    )
    plot = Plot(chart.title, across, up, width=480, height=300)
    for place, series in enumerate(chart.series):
        style, marker = _STYLES[place % len(_STYLES)]
        marked = not series.line or len(series.x) <= _MARKED
        plot.keys.append(Key(style, series.name, marker if marked else ""))
        x, y = (_drawn(values, axis) for values, axis in ((series.x, plot.x), (series.y, plot.y)))
        if series.line:
            above = [
                pair
                for pair in zip(x, y, series.x, series.y, strict=True)
                if not (_low(pair[2], plot.x) or _low(pair[3], plot.y))
            ]
            plot.line(series.name, style, [pair[0] for pair in above], [pair[1] for pair in above])
        for left, up, true_x, true_y in (
            zip(x, y, series.x, series.y, strict=True) if marked else ()
        ):
            plot.point(
                left,
                up,
                style,
                marker,
                f"{series.name}: {chart.x.quantity} {number(true_x)}, {chart.y.quantity} {number(true_y)}",
            )
    if chart.level is not None:
        plot.level(chart.level, chart.level_words)
    plot.words = (
        chart.words
        or f"{capital(chart.y.quantity)} against {chart.x.quantity}, {count(len(chart.series), 'curve')}."
    )
    if any(
        _low(x, plot.x) or _low(y, plot.y)
        for series in chart.series
        for x, y in zip(series.x, series.y, strict=True)
    ):
        plot.words += " Zeros cannot be drawn on a logarithmic axis: their points are at its lower end, off the line."
    return plot


def _low(value: float, axis: Axis) -> bool:
    return axis.log and value <= 0


def _axis(axis: AxisRecord, values: list[float]) -> Axis:
    positive = [value for value in values if value > 0]
    if axis.log and positive:
        if len(positive) < len(values):  # room for zeros below
            positive.append(min(positive) * (max(positive) / min(positive)) ** -_BELOW / 2)
        return Axis.fitted(axis.quantity, axis.unit, positive, log=True)
    return Axis.fitted(axis.quantity, axis.unit, values)


def _drawn(values: tuple[float, ...], axis: Axis) -> list[float]:
    """Return values, with zeros at the low end of a logarithmic axis."""
    return [max(value, axis.low) if axis.log else value for value in values]
