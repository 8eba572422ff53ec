"""`suite`: CPU seconds of each stage, beside what people would use instead."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median

import click

from benchmarks.measure import Sample, Size, sample
from benchmarks.options import COUNT, out_option
from benchmarks.results import as_text, store
from benchmarks.suite.cases import CASES, OURS, RATIOS, TARGET_SIZE, Case, Ratio, Row
from validate.campaign.selection import matches
from validate.cli.table import one_line
from validate.processes.disk import temporary_folder

# Wall seconds of one measurement.
LIMIT = 600.0
_EPILOG = """\b
Examples:
  python -m benchmarks suite --size 3x50 --rounds 2
  python -m benchmarks suite -k "gd_iteration or cs_replay"

Every measurement is a child process with one thread; all stages and peers of a
size take turns, round after round. Peers are measured if they are installed:
pip install -e '.[bench,bench-drake]'

\b
Exit codes: 0 measured; 1 a stage of ours gave no answer; 2 usage, or nothing
selected.
"""


def _sizes(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> tuple[Size, ...]:
    found = []
    for value in values:
        parts = re.fullmatch(r"(\d+)x(\d+)", value)
        if parts is None or not 3 <= int(parts[1]) <= 20 or int(parts[2]) < 1:
            raise click.BadParameter(
                f"{value!r} is no size; write carts x steps, such as 3x500, with 3 to 20 carts.",
                context,
                parameter,
            )
        found.append(Size(int(parts[1]), int(parts[2])))
    return tuple(found)


@click.command(epilog=_EPILOG)
@click.option(
    "-k",
    "expression",
    default="",
    metavar="EXPR",
    help="Only stages and peers whose names match: words joined with and, or, not.",
)
@click.option(
    "--size",
    "sizes",
    multiple=True,
    metavar="NxT",
    callback=_sizes,
    default=["3x500"],
    show_default=True,
    help="Carts x steps; may be repeated.",
)
@click.option("--rounds", type=COUNT, default=5, show_default=True)
@out_option
def command(expression: str, sizes: tuple[Size, ...], rounds: int, out: Path) -> int:
    """Measure each stage - compile, build, translate, evaluate, solve, descend, replay - and its peers."""
    cases, left_out = selected(expression)
    rows = measured(cases, sizes, rounds)
    figures = [
        (ratio, size, value)
        for size in sizes
        for ratio in RATIOS
        if (value := ratio.of(rows, size)) is not None
    ]
    click.echo(as_text(("stage", "by", "n x T", "CPU s", "outcome"), [_line(row) for row in rows]))
    if figures:
        columns = ("ratio", "n x T", "measured", "at most", "")
        click.echo("\n" + as_text(columns, [_figure(*figure) for figure in figures]))
    for sentence in left_out:
        click.echo(one_line(sentence))
    written = store(
        out,
        "suite",
        {
            "rounds": rounds,
            "rows": [asdict(row) for row in rows],
            "ratios": [
                {"what": ratio.what, "n": size.n, "steps": size.steps, "measured": value}
                for ratio, size, value in figures
            ],
        },
    )
    click.echo(f"\nwritten: {written}")
    failed = [row.failed for row in rows if row.failed and row.by == OURS]
    for sentence in failed:
        click.echo(one_line(f"fails: {sentence}"), err=True)
    return 1 if failed else 0


def selected(expression: str) -> tuple[list[Case], list[str]]:
    """The cases that can be measured, and why the rest of the selected ones cannot.

    Raises click.UsageError if none is left, SelectionError.
    """
    chosen = [case for case in CASES if not expression or matches(expression, case.names)]
    able = [case for case in chosen if not case.missing()]
    left_out = [sentence for case in chosen if (sentence := case.missing())]
    if not able:
        names = ", ".join(dict.fromkeys(name for case in CASES for name in case.names))
        why = " ".join(left_out) or f"stages and peers are {names}."
        raise click.UsageError(f"nothing is selected by {expression!r}: {why}")
    return able, left_out


def measured(cases: Sequence[Case], sizes: Sequence[Size], rounds: int) -> list[Row]:
    """Measure every case at every size, in turns. A case that failed is not repeated."""
    rows = []
    with temporary_folder("touchstone-bench-") as folder:
        for size in dict.fromkeys(sizes):
            samples: dict[Case, list[Sample]] = {case: [] for case in cases}
            for number in range(1, rounds + 1):
                click.echo(f"{size}: round {number} of {rounds}", err=True)
                for case, found in samples.items():
                    if not found or not found[-1].failed:
                        found.append(_sample(case, size, folder))
            rows += [_row(case, size, found) for case, found in samples.items()]
    return rows


def _sample(case: Case, size: Size, folder: Path) -> Sample:
    what = f"{case.stage} by {case.by} at {size}"
    return sample(case.function, size, folder, seconds=LIMIT, what=what, once=case.once)


def _row(case: Case, size: Size, samples: Sequence[Sample]) -> Row:
    last = samples[-1]
    return Row(
        stage=case.stage,
        by=case.by,
        n=size.n,
        steps=size.steps,
        cpu_s=() if last.failed else tuple(found.cpu_s or 0.0 for found in samples),
        outcome=last.outcome,
        iterations=last.iterations,
        value=last.value,
        failed=last.failed,
    )


def _line(row: Row) -> tuple[str | float | None, ...]:
    seconds = float(f"{median(row.cpu_s):.3g}") if row.cpu_s else None
    words = one_line(row.failed or row.outcome)
    return (row.stage, row.by, f"{row.n}x{row.steps}", seconds, words)


def _figure(ratio: Ratio, size: Size, value: float) -> tuple[str | float | None, ...]:
    word = "met" if value <= ratio.target else "missed"
    verdict = word if size == TARGET_SIZE else f"the target is set for {TARGET_SIZE}"
    shown = (float(f"{number:.3g}") for number in (value, ratio.target))
    return (ratio.what, f"{size.n}x{size.steps}", *shown, verdict)
