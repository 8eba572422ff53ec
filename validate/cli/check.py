"""`check`: whether FMUs do what they say; as tables, JSON, a page, and JUnit XML."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

import click

from validate.cli.options import FiniteRange
from validate.cli.table import one_line, print_table, say, wide_option
from validate.fmu_check import CheckReport, FmuCheckRow, check_fmu
from validate.store.disk import make_folder, write_durably

# An FMU's report, with the seconds that its checks took: wall and CPU [s].
Checked: TypeAlias = tuple[CheckReport, float, float]
_EPILOG = """\b
Examples:
  python -m validate check model.fmu
  python -m validate check model.fmu --only "set state restores"
  python -m validate check model.fmu --html check.html
  python -m validate check build/*.fmu --junit check.xml

Exit codes: 0 all that is offered passed; 1 something failed; 2 a file is no FMU of
version 2.0 or 3.0; 3 nothing failed, but code cannot be run on this machine.
"""
_COLOURS = {"passed": "green", "failed": "red", "not offered": "bright_black"}
_SIGNS = {"passed": "✓", "failed": "✗", "not offered": "-"}


@click.command(epilog=_EPILOG)
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE.fmu...", nargs=-1, required=True)
@click.option("--only", "names", multiple=True, metavar="NAME", help="Only the check of this name; may be repeated.")
@click.option("--time-limit", type=FiniteRange(min=0.1), default=60.0, show_default=True, metavar="SECONDS", help="For each check.")
@click.option("--json", "as_json", is_flag=True, help="The results as JSON on stdout: an object; of several FMUs, a list of them.")
@click.option(
    "--html",
    "html_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.html",
    help="Write a page there with every check.",
)
@click.option(
    "--junit",
    "junit_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.xml",
    help="Write JUnit XML there, for CI: a test suite an FMU, a test case a check.",
)
@wide_option
@click.pass_obj
def command(
    arguments: tuple[str, ...],
    files: tuple[Path, ...],
    names: tuple[str, ...],
    time_limit: float,
    as_json: bool,
    html_file: Path | None,
    junit_file: Path | None,
) -> int:
    """Check any FMU (FMI 2.0 or 3.0, Model Exchange and Co-Simulation), its files and how its code behaves.

    Each check claims something of a sound FMU. It is passed, failed or not offered, and a sentence says what was found. The FMU runs
    in child processes: one that hangs or crashes fails the check, and harms nothing else.
    """
    checked: list[Checked] = []
    for file in files:
        before = os.times()
        report = check_fmu(file, names=names or None, seconds=time_limit)
        after = os.times()
        cpu = sum(after[:4]) - sum(before[:4])
        checked.append((report, after.elapsed - before.elapsed, cpu))
        if not as_json:
            _print(report, last=len(checked) == len(files))
    if as_json:
        found = [_data(report) for report, _, _ in checked]
        click.echo(json.dumps(found if len(found) > 1 else found[0], indent=1, allow_nan=False))
    if html_file is not None:
        make_folder(html_file.parent)
        write_durably(html_file, _page(checked, arguments))
    if junit_file is not None:
        make_folder(junit_file.parent)
        write_durably(junit_file, _junit(checked))
    return max((_code(report) for report, _, _ in checked), key=(0, 3, 1).index)


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


def _print(report: CheckReport, *, last: bool) -> None:
    rows = [[f"{_SIGNS[row.status.value]} {row.status.value}", _name(row), row.sentence] for row in report.rows]
    colours = {f"{_SIGNS[name]} {name}": colour for name, colour in _COLOURS.items()}
    print_table(["", "check", "what was found"], rows, colours=colours)
    click.echo()
    say(_summary(report))
    if not last:
        click.echo()


def _name(row: FmuCheckRow) -> str:
    return f"{row.name} ({row.type})" if row.type else row.name


def _page(checked: Sequence[Checked], arguments: tuple[str, ...]) -> str:
    """The page that a report has of its FMUs, of these."""
    from reports.records.check_record import CheckRecord
    from reports.render import render_checks
    from validate.store.provenance import command_line, gather
    from validate.tasks.fmu_checks import found_by

    origin, records = gather(command_line(arguments)), []
    for report, spent, cpu in checked:
        found = found_by(report, Path(report.path), 0.0, spent)
        record = CheckRecord(
            key=report.path,
            kind="FMU",
            name=one_line(report.path),
            expected="it passes every check of what it offers.",
            outcome="answered",
            passed=found.passed,
            found=found.sentence,
            wall_seconds=spent,
            cpu_seconds=cpu,
            provenance=origin,
            **found.details,
        )
        records.append(record)
    return render_checks(records)


def _junit(checked: Sequence[Checked]) -> bytes:
    """JUnit XML: what was measured is the message of a failure; what an FMU does not offer is skipped."""
    suites = ElementTree.Element("testsuites", name="touchstone check")
    for report, spent, _ in checked:
        statuses = [row.status.value for row in report.rows]
        suite = ElementTree.SubElement(
            suites,
            "testsuite",
            name=one_line(report.path),
            time=f"{spent:.3f}",
            tests=str(len(statuses)),
            failures=str(statuses.count("failed")),
            skipped=str(statuses.count("not offered")),
            errors="0",
        )
        for row in report.rows:
            case = ElementTree.SubElement(suite, "testcase", name=_name(row), classname=one_line(report.path), time=f"{row.seconds:.3f}")
            if row.status.value == "failed":
                failure = ElementTree.SubElement(case, "failure", message=one_line(row.sentence))
                failure.text = f"A sound FMU: {one_line(row.claim)}"
            elif row.status.value == "not offered":
                ElementTree.SubElement(case, "skipped", message=one_line(row.sentence))
    ElementTree.indent(suites)
    return ElementTree.tostring(suites, encoding="utf-8", xml_declaration=True)
