"""`check`: whether an FMU does what it says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validate.cli.options import FiniteRange
from validate.cli.table import print_table, say, wide_option

if TYPE_CHECKING:
    from validate.fmu_check import CheckReport

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
@wide_option
def command(file: Path, names: tuple[str, ...], time_limit: float, as_json: bool) -> int:
    """Check any FMU (FMI 2.0 or 3.0, Model Exchange and Co-Simulation), its files and how its code behaves.

    Each check claims something of a sound FMU; it is passed, failed or not offered, with one sentence. The FMU runs in child
    processes: one that hangs or crashes has failed the check, and nothing else happens.
    """
    from validate.fmu_check import check_fmu

    report = check_fmu(file, names=names or None, seconds=time_limit)
    if as_json:
        click.echo(json.dumps(_data(report), indent=1, allow_nan=False))
    else:
        _print(report)
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
    return f"{report.path}{about}: {counts}{missing}"


def _print(report: CheckReport) -> None:
    rows = [
        [f"{_SIGNS[row.status.value]} {row.status.value}", f"{row.name} ({row.type})" if row.type else row.name, row.sentence]
        for row in report.rows
    ]
    colours = {f"{_SIGNS[name]} {name}": colour for name, colour in _COLOURS.items()}
    print_table(["", "check", "what was found"], rows, colours=colours)
    click.echo()
    say(_summary(report))
