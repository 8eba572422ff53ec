"""`truth`: the contact truth suite."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import click

from reports.pages.simulators import as_markdown, cell, largest_disagreement
from reports.records.check_record import ChartRecord
from reports.records.engines_record import TruthRecord, TruthRow
from reports.render import render_truth
from validate.cli.options import write, written_to
from validate.cli.table import print_table, say, wide_option
from validate.execution.process import usable_cores
from validate.judge.disagreement import REFERENCE
from validate.judge.simulator import describe_engine, engine_names, named_engines
from validate.store.provenance import command_line
from validate.stress.case import chart
from validate.tasks.truth import NEAR, measure

# Of the CSV.
_OF_ROWS = ("phenomenon", "problem", "engine", "came", "kind", "worst", "order", "sentence")
_OF_LEVELS = ("step", "tolerance", "error", "energy", "microseconds", "seconds")
# Problems whose error is drawn against CPU time, by phenomenon: one with a closed form of each kind of contact.
_DRAWN = ("rebound", "two-body collision", "grazing contact", "stick-slip")


@click.command(
    epilog="""\b
Examples:
  python -m validate truth
  python -m validate truth --engine fmu,mujoco --out runs/truth

Exit codes: 0 our reference is right to 1e-7 on every problem, whatever the others
are; 1 it is not; 2 a mistake; 3 an engine that was asked for by name is not
installed, or a system requirement is missing.
"""
)
@click.option("--engine", "engines", metavar="NAME,..", help="Engines to ask, by name; without it all there are.")
@click.option("-j", "--jobs", type=click.IntRange(min=1), metavar="N", help="Problems at a time.  [default: the number of cores]")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help="Write truth.html, truth.csv and truth.json there."
)
@written_to("--markdown", "markdown", "FILE.md", "the table of errors, as docs/truth.md is")
@wide_option
@click.pass_obj
def command(arguments: tuple[str, ...], engines: str | None, jobs: int | None, out: Path | None, markdown: Path | None) -> int:
    """Put problems with exact answers to our FMU and to other simulators.

    Thirteen phenomena, from a rebound to stick-slip, each at four steps: error, order, energy, time, and a sentence on the largest disagreement.
    docs/engines.md says what each engine is told.
    """
    asked = named_engines(engines) if engines else engine_names()
    found = measure(asked, jobs=jobs or usable_cores(), tell=lambda text: click.echo(text, err=True))
    record = recorded(asked, found)
    if out is not None:
        write(out / "truth.html", lambda: render_truth(record, command_line(arguments)))
        write(out / "truth.csv", lambda: as_csv(record))
        write(out / "truth.json", lambda: record.model_dump_json(indent=1))
    write(markdown, lambda: as_markdown(record, command_line(arguments)))
    shown = [[f"{of[0].phenomenon}: {of[0].problem}", *map(cell, of)] for of in record.problems]
    print_table(["problem", *asked], shown, tuple(asked))
    click.echo()
    for of in record.problems:
        worst = largest_disagreement(of)
        if worst is not None:
            say(f"{worst.phenomenon}, {worst.problem}: furthest is {worst.engine}: {worst.sentence}.")
    say(record.summary)
    return 0 if reference_is_right(record.rows) else 1


def reference_is_right(rows: Sequence[TruthRow]) -> bool:
    """Whether our reference, where it was asked, is as near to every answer as it must be."""
    return all(row.error is not None and row.error <= NEAR for row in rows if row.engine == REFERENCE)


def recorded(engines: tuple[str, ...], rows: Sequence[TruthRow]) -> TruthRecord:
    """What is written of it."""
    about = {name: describe_engine(name) for name in engines}
    told = {name: f"{' '.join((item.title, _version(item.package))).rstrip()}; {item.law}" for name, item in about.items()}
    summary = f"{len({row.phenomenon for row in rows})} phenomena in {len(rows) // len(engines)} problems, by {', '.join(engines)}."
    own = [row.error for row in rows if row.engine == REFERENCE and row.error is not None]
    if own:
        summary += f" Our reference is within {max(own):.1g} of every answer ({NEAR:g} is asked of it)."
    charts = tuple(chart for name in _DRAWN if (chart := _chart(name, rows)) is not None)
    return TruthRecord(engines=told, rows=tuple(rows), summary=summary, charts=charts)


def _version(package: str) -> str:
    try:
        return metadata.version(package) if package else ""
    except metadata.PackageNotFoundError:
        return ""


def _chart(phenomenon: str, rows: Sequence[TruthRow]) -> ChartRecord | None:
    """Error against CPU time of the first problem of a phenomenon, a curve an engine."""
    of = [row for row in rows if row.phenomenon == phenomenon]
    drawn = {
        row.engine: ([level.seconds for level in row.levels], [math.nan if level.error is None else level.error for level in row.levels])
        for row in of
        if row.problem == of[0].problem and row.levels
    }
    if not drawn:
        return None
    words = "Down and to the left is better: less error for less time. Each curve is one engine at four steps or tolerances."
    return chart(f"{phenomenon}, {of[0].problem}", ("CPU time", "s"), ("error", ""), drawn, log="xy", words=words)


def as_csv(record: TruthRecord) -> str:
    """A row a level: all that was measured; times come last, as nothing else differs between two runs."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow((*_OF_ROWS, *_OF_LEVELS))
    for row in record.rows:
        for level in row.levels or (None,):
            found = [getattr(row, name) for name in _OF_ROWS] + [getattr(level, name, None) for name in _OF_LEVELS]
            rows.writerow(["" if value is None else repr(value) if isinstance(value, float) else value for value in found])
    return text.getvalue()
