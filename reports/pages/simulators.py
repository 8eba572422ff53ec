"""Results of engines: on one plan (`replay --engine`), and on the truth suite (`truth`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from models.results.engines import TruthRecord, TruthRow
from reports.pages.checks import plot_of
from reports.pages.section import Section
from reports.render import render_sections


def of_plan(rows: Sequence[Mapping[str, Any]]) -> Section:
    """Return the section of one plan."""
    return Section(
        "engines", "Verdicts of other simulators", "simulators.html#plan", {"rows": rows}
    )


def truth_page(record: TruthRecord, again: str) -> str:
    """Return the page of the truth suite; again: its command."""
    return render_sections(
        [truth(record)], title="The contact truth suite", lead=record.summary, again=again
    )


def truth(record: TruthRecord) -> Section:
    """Return the section of the truth suite."""
    plots = [plot_of(chart) for chart in record.charts]
    values = {"record": record, "problems": record.problems, "plots": plots}
    return Section("truth", "Exact answers, and results of engines", "truth.html", values)


def as_markdown(record: TruthRecord, command: str) -> str:
    """Return the truth suite as a page of the docs, without times, so that it is reproducible."""
    head = ["problem", *record.engines, "exact answer"]
    made = f"Made by `{command}`; [engines.md](engines.md) describes the input of each engine."
    shares = "Errors at the finest of four steps, as shares of the problem's scale; in brackets the order at which they fall with the step."
    lines = ["# The contact truth suite", "", made, "", record.summary, ""]
    lines += [
        *(f"- **{name}**: {words}." for name, words in record.engines.items()),
        "",
        shares,
        "",
    ]
    lines += [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for rows in record.problems:
        cells = [f"{rows[0].phenomenon}: {rows[0].problem}", *map(cell, rows), rows[0].source]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def cell(row: TruthRow) -> str:
    """Return the error at the finest level and its order, or the status."""
    if row.came != "done":
        return row.came
    return (
        "diverges"
        if row.error is None
        else f"{row.error:.0e}{'' if row.order is None else f' ({row.order:.1f})'}"
    )
