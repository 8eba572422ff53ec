"""`suite`: each stage measured beside what people would use instead."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click
from pydantic import ValidationError

from benchmarks.measure import Size
from benchmarks.options import out_option
from benchmarks.records import SuiteRecord, middle, spread
from benchmarks.results import store, typed
from benchmarks.suite.cases import FULL_SIZES, QUICK_SIZES
from benchmarks.suite.compare import Comparison, compare
from benchmarks.suite.run import QUICK_REPEATS, REPEATS, Settings, failures, plan, run_suite
from validate.cli.table import one_line, table
from validate.store.disk import make_folder

_EPILOG = """\b
Examples:
  python -m benchmarks suite --quick
  python -m benchmarks suite -k "gd_iteration or cs_replay" --size 3x500
  python -m benchmarks suite --compare runs/benchmarks/suite.json

Every measurement is a child process with one thread; all stages and peers of a
size take turns, round after round, beside a fixed piece of work that tells how
fast the machine is. Peers are measured where they are installed:
pip install -e '.[bench]' drake

\b
--compare: worse is a median more than 15 % above the earlier one (memory: and
2 MiB more) in samples that a rank test tells apart (p <= 1 %), times after both
runs were divided by their fixed piece of work; so is an answer that is gone.

\b
Exit codes: 0 measured; 1 a stage of ours gave no answer, or --compare found a
regression beyond its noise; 2 usage, or nothing selected.
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
    "--quick", is_flag=True, help="A tiny size, two rounds: whether it runs, not how fast it is."
)
@click.option(
    "-k",
    "expression",
    default="",
    metavar="EXPR",
    help="Only stages and peers whose names match, in upper or lower case: words joined with and, or, not.",
)
@click.option(
    "--size",
    "sizes",
    multiple=True,
    metavar="NxT",
    callback=_sizes,
    help="Carts x steps, such as 3x500; may be repeated.",
)
@click.option(
    "--repeats",
    type=click.IntRange(min=1),
    metavar="N",
    help="Rounds: 5, with --quick 2 (too few for --compare).",
)
@click.option(
    "--slow",
    is_flag=True,
    help="Also what takes minutes: quick campaigns, once each.",
)
@click.option(
    "--campaign",
    type=click.Path(path_type=Path),
    default="runs/all",
    show_default=True,
    metavar="DIR",
    help="Whose report is measured.",
)
@out_option
@click.option(
    "--compare", "earlier", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.json",
    help="Fail on what got worse since that file."
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="The figures as JSON on stdout.")
def command(
    quick: bool, expression: str, sizes: tuple[Size, ...], repeats: int | None, slow: bool,
    campaign: Path, out: Path, earlier: Path | None, as_json: bool
) -> int:  # fmt: skip
    """Measure each stage - compile, build, translate, evaluate, solve, descend, replay, report - and its peers: median, spread, memory, over n T."""
    before = None if earlier is None else read_suite(earlier)
    settings = Settings(
        sizes=sizes or (QUICK_SIZES if quick else FULL_SIZES),
        repeats=repeats or (QUICK_REPEATS if quick else REPEATS),
        expression=expression,
        slow=slow,
        quick=quick,
        campaign=campaign if (campaign / "campaign.json").is_file() else None,
        command=typed(),
    )
    plan(settings)  # refuses what selects nothing
    make_folder(out)  # better refused now than when all is measured
    record = run_suite(settings, lambda sentence: click.echo(one_line(sentence), err=True))
    comparison = None if before is None else compare(before, record)
    if before is not None and comparison is not None and not comparison.pairs:
        raise click.UsageError(
            f"{earlier}: it has no stage and size in common with this run; compare runs with the same --size and -k."
        )
    if as_json:
        click.echo(record.model_dump_json(indent=1))
    else:
        _tell(record)
    written = store(out, "suite", record)
    if not as_json:
        click.echo(f"\nwritten: {written}")
    if comparison is not None:
        _tell_comparison(comparison, err=as_json)
    failed = failures(record)
    for sentence in failed:
        click.echo(one_line(f"fails: {sentence}"), err=True)
    return 1 if failed or (comparison is not None and comparison.regressions) else 0


def read_suite(path: Path) -> SuiteRecord:
    """The figures that an earlier run wrote. Raises click.UsageError."""
    try:
        return SuiteRecord.model_validate_json(path.read_bytes())
    except OSError as error:
        raise click.UsageError(
            f"{path} cannot be read ({error.strerror}); give a suite.json that an earlier run of `suite` wrote."
        ) from error
    except (ValidationError, json.JSONDecodeError) as error:
        raise click.UsageError(
            f"{path} is no record of this suite; give a suite.json that an earlier run of `suite` wrote."
        ) from error


def _tell(record: SuiteRecord) -> None:
    def plain(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    lines = [
        [
            row.stage, row.by, f"{row.n}x{row.steps}" if row.n else "",
            plain(middle(row.cpu_s), ".3g"), plain(spread(row.cpu_s), ".0%"),
            plain(middle(row.memory_mib), ".1f"), one_line(row.failed or row.outcome),
        ]
        for row in record.rows
    ]  # fmt: skip
    click.echo(table(["stage", "by", "n x T", "seconds", "spread", "MiB", "outcome"], lines))
    words = {True: "met", False: "missed", None: "not judged"}
    told = [
        [item.what, f"{item.n}x{item.steps}" if item.steps else "", plain(item.measured, ".3g"),
         f"{item.target:.3g} {item.unit}".strip(), words[item.met], one_line(item.why)]
        for item in record.figures
    ]  # fmt: skip
    if told:
        click.echo("\n" + table(["figure", "n x T", "measured", "at most", "", ""], told))
    for sentence in record.left_out:
        click.echo(one_line(sentence))
    cores = record.provenance.cores
    if record.load is not None and max(record.load) > cores:
        click.echo(
            f"the machine was busy: its load was {record.load[0]:.1f} before and {record.load[1]:.1f} after, on {cores} cores."
        )


def _tell_comparison(comparison: Comparison, *, err: bool) -> None:
    lines = []
    for change in comparison.changes:
        row = change.row
        figures = [
            "" if value is None else f"{value:.3g}"
            for value in (change.before, change.after, change.factor)
        ]
        lines.append(
            [
                change.kind.value,
                row.stage,
                row.by,
                f"{row.n}x{row.steps}" if row.n else "",
                change.quantity,
                *figures,
                one_line(change.why),
            ]
        )
    if lines:
        click.echo(
            "\n" + table(["", "stage", "by", "n x T", "of", "before", "now", "factor", ""], lines),
            err=err,
        )
    speed = (
        ""
        if comparison.speed is None
        else f"; the yardstick takes {comparison.speed:.2f} times as long, which is allowed for"
    )
    count = len(comparison.regressions)
    click.echo(
        f"{_rows(comparison.pairs)} in both: {count or 'no'} regression{'s' if count > 1 else ''}{speed}",
        err=err,
    )


def _rows(pairs: int) -> str:
    return "1 row is" if pairs == 1 else f"{pairs} rows are"
