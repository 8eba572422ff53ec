"""What engines say: of one plan (`replay --engine`), of a campaign's cheapest plan on each scene (`report --engine`), and of the truth suite (`truth`).

Of the suite: a table of problems by engines, what explains the largest disagreement on each, and
error against CPU time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from reports.pages.checks import plot_of
from reports.pages.section import Report, Section
from reports.records.engines_record import EngineRecord, TruthRecord, TruthRow
from reports.records.record import RunRecord
from reports.wording import count, listing


def of_plan(rows: Sequence[Mapping[str, Any]]) -> list[Section]:
    """The section of one plan; none where no engine was asked."""
    return (
        [Section("engines", "What other simulators say", "simulators.html#plan", {"rows": rows})]
        if rows
        else []
    )


def build(report: Report) -> Section | None:
    """The section of a campaign: scenes by engines, and why where one says otherwise.

    None where none was asked of a run that is still there.
    """
    told = report.stored.simulators
    if told is None:
        return None
    runs = [run for run in report.stored.runs if run.key in told.plans]
    asked = [
        (run, report.link(run), {row.engine: row for row in told.plans[run.key]}) for run in runs
    ]
    if not asked:
        return None
    engines = {
        name: words
        for name, words in told.engines.items()
        if any(name in rows for _, _, rows in asked)
    }
    said = [
        sentence(name, [(run, rows[name]) for run, _, rows in asked if name in rows])
        for name in engines
    ]
    otherwise = [
        (run, link, row) for run, link, rows in asked for row in rows.values() if not row.agrees
    ]
    values = {"said": said, "engines": engines, "asked": asked, "otherwise": otherwise}
    return Section(
        "simulators", "What other simulators say", "simulators.html#campaign", values, said=said[0]
    )


def sentence(engine: str, rows: Sequence[tuple[RunRecord, EngineRecord]]) -> str:
    """In how many plans an engine agrees with us, why not in the others, and what it could not be asked."""
    compared = [row for _, row in rows if row.agrees is not None]
    same = sum(bool(row.agrees) for row in compared)
    kinds = Counter(row.kind or "no class" for row in compared if not row.agrees)
    untold = [f"{run.scene.name} ({row.verdict})" for run, row in rows if row.agrees is None]
    words = [
        f"{engine} gives our verdict on {same} of {count(len(compared), 'plan')} that it can step"
    ]
    words += (
        [f"otherwise by {listing([f'{kind} ({number})' for kind, number in kinds.most_common()])}"]
        if kinds
        else []
    )
    words += [f"no answer on {listing(untold)}"] if untold else []
    return f"{'; '.join(words)}."


def truth(record: TruthRecord) -> Section:
    """The section of the page."""
    largest, plots = (
        [largest_disagreement(rows) for rows in record.problems],
        [plot_of(chart) for chart in record.charts],
    )
    values = {"record": record, "problems": record.problems, "largest": largest, "plots": plots}
    return Section("truth", "What is true, and what engines make of it", "truth.html", values)


def largest_disagreement(rows: tuple[TruthRow, ...]) -> TruthRow | None:
    """The row that is furthest from the truth.

    Of those that came to no number the first, where all others are no further; None without a row.
    """
    lost = [row for row in rows if row.came == "done" and row.error is None]
    told = sorted((row for row in rows if row.error is not None), key=lambda row: row.error or 0.0)
    return next(iter([*lost, *reversed(told), *rows]), None)


def as_markdown(record: TruthRecord, command: str) -> str:
    """The same as a page of the docs, without times: it is equal whenever it is made."""
    head = ["problem", *record.engines]
    made = f"Made by `{command}`; [engines.md](engines.md) says what each engine is told."
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
        lines.append(f"| {rows[0].phenomenon}: {rows[0].problem} | {' | '.join(map(cell, rows))} |")
    lines += [
        "",
        "What explains the largest disagreement:",
        "",
        "| problem | exact answer | furthest | why |",
        "|---|---|---|---|",
    ]
    for rows in record.problems:
        worst = largest_disagreement(rows)
        if worst is not None:
            lines.append(
                f"| {worst.phenomenon}: {worst.problem} | {worst.source} | {worst.engine} | {worst.sentence} |"
            )
    return "\n".join(lines) + "\n"


def cell(row: TruthRow) -> str:
    """The error at the finest level and its order, or what came of asking."""
    if row.came != "done":
        return row.came
    return (
        "diverges"
        if row.error is None
        else f"{row.error:.0e}{'' if row.order is None else f' ({row.order:.1f})'}"
    )
