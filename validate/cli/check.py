"""`check`: whether an FMU does what it says."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validate.cli.options import FiniteRange
from validate.cli.table import one_line, use_colour

if TYPE_CHECKING:
    from validate.fmu_check import CheckReport, FmuCheckRow

_EPILOG = """\b
Examples:
  python -m validate check model.fmu
  python -m validate check model.fmu --only "set state restores"
  python -m validate check model.fmu --json

\b
Exit codes: 0 all that is offered passed; 1 something failed; 2 no FMU of version
2.0 or 3.0; 3 nothing failed, but its code cannot be run on this machine.
"""
_COLOURS = {"passed": "green", "failed": "red", "not offered": "bright_black"}
_SIGNS = {"passed": "✓", "failed": "✗", "not offered": "-"}


@click.command(epilog=_EPILOG)
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.fmu")
@click.option("--only", "names", multiple=True, metavar="NAME", help="Only the check of this name; may be repeated.")
@click.option("--time-limit", type=FiniteRange(min=0.1), default=60.0, show_default=True, metavar="SECONDS", help="For each check.")
@click.option("--json", "as_json", is_flag=True, help="The results as JSON on stdout.")
def command(file: Path, names: tuple[str, ...], time_limit: float, as_json: bool) -> int:
    """Check any FMU (FMI 2.0 or 3.0, Model Exchange and Co-Simulation), its files and how its code behaves.

    Each check claims something of a sound FMU; it is passed, failed or not offered, with one sentence. The FMU runs in child
    processes: one that hangs or crashes has failed the check, and nothing else happens.
    """
    from validate.fmu_check import check_fmu

    report = check_fmu(file, names=names or None, seconds=time_limit)
    if as_json:
        click.echo(json.dumps(_data(report), indent=1, allow_nan=False))
    elif sys.stdout.isatty() and os.environ.get("TERM") != "dumb":
        _print_rich(report)
    else:
        _print_plain(report)
    return _code(report)


def _code(report: CheckReport) -> int:
    if not report.ok:
        return 1
    return 3 if report.unrunnable else 0


def _data(report: CheckReport) -> dict:
    rows = [
        {
            "check": row.name,
            "type": row.type,
            "claim": row.claim,
            "status": row.status.value,
            "sentence": row.sentence,
            "seconds": row.seconds,
        }
        for row in report.rows
    ]
    return {
        "file": report.path,
        "fmi": report.version,
        "types": list(report.types),
        "ok": report.ok,
        "exit_code": _code(report),
        "rows": rows,
    }


def _summary(report: CheckReport) -> str:
    words = [row.status.value for row in report.rows]
    counts = ", ".join(f"{words.count(word)} {word}" for word in _COLOURS)
    about = f" (FMI {report.version}, {' and '.join(report.types)})" if report.types else ""
    missing = "; its code cannot be run on this machine" if report.unrunnable else ""
    return one_line(f"{report.path}{about}: {counts}{missing}")


def _label(row: FmuCheckRow) -> str:
    return f"{row.name} ({row.type})" if row.type else row.name


def _print_plain(report: CheckReport) -> None:
    """One line a check, for pipes and logs: status, name, sentence."""
    width = max(len(_label(row)) for row in report.rows)
    for row in report.rows:
        click.echo(f"{row.status.value:11}  {_label(row):{width}}  {one_line(row.sentence)}")
    click.echo()
    click.echo(_summary(report), color=use_colour())


def _print_rich(report: CheckReport) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(no_color=use_colour() is False)
    table = Table(show_edge=False, pad_edge=False, header_style="bold")
    for title in ("", "check", "type", "what was found"):
        table.add_column(title, no_wrap=title in ("", "type"))
    for row in report.rows:
        style = _COLOURS[row.status.value]
        status = Text(f"{_SIGNS[row.status.value]} {row.status.value}", style=style)
        table.add_row(status, Text(row.name), row.type, Text(one_line(row.sentence), style=style if row.status.value != "passed" else ""))
    console.print(table)
    console.print()
    console.print(_summary(report), markup=False, highlight=False)
