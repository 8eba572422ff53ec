"""The command `check`: checks of FMUs, printed as they end, or as JSON, a page and JUnit XML."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import click

from validate.cli.options import FiniteRange, write, written_to
from validate.cli.table import one_line, say, wide_option
from validate.fmu_check import CheckReport, FmuCheckRow, Status, check_fmu
from validate.store.provenance import command_line

# A report of an FMU, with wall and CPU time of its checks [s].
Checked: TypeAlias = tuple[CheckReport, float, float]
_EPILOG = """\b
Examples:
  python -m validate check model.fmu
  python -m validate check model.fmu --only "set state restores"
  python -m validate check model.fmu --html check.html
  python -m validate check build/*.fmu --junit check.xml
  python -m validate check model.fmu --waive "runs repeat=it draws random numbers"

Exit codes: 0 nothing failed that is not waived; 1 something did; 2 a file is no FMU of
version 2.0 or 3.0; 3 nothing failed, but code cannot be run on this machine.
"""
_COLOURS = {
    "passed": "green",
    "failed": "red",
    "not offered": "bright_black",
    "advice": "yellow",
    "waived": "cyan",
}
_SIGNS = {"passed": "✓", "failed": "✗", "not offered": "-", "advice": "!", "waived": "~"}


@click.command(epilog=_EPILOG)
@click.argument(
    "files", type=click.Path(path_type=Path), metavar="FILE.fmu...", nargs=-1, required=True
)
@click.option(
    "--only",
    "names",
    multiple=True,
    metavar="NAME",
    help="Run only the check with this name; may be repeated.",
)
@click.option(
    "--time-limit",
    type=FiniteRange(min=0.1),
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="Limit the wall time of each check.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the results as JSON: an object, or a list for several FMUs.",
)
@written_to("--html", "html_file", "FILE.html", "a page with every check")
@written_to(
    "--junit",
    "junit_file",
    "FILE.xml",
    "JUnit XML, for CI: a test suite an FMU, a test case a check",
)
@click.option(
    "--waive",
    "waivers",
    multiple=True,
    metavar="NAME=REASON",
    help="Accept a failure of this check for a reason: it is shown as waived and does not count; may be repeated.",
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
    waivers: tuple[str, ...],
) -> int:
    """Check the files and the behaviour of FMUs (FMI 2.0 or 3.0, Model Exchange and Co-Simulation).

    Each check states a claim about a sound FMU, which is passed, failed or not offered, with a
    sentence about the result. The FMU runs in child processes: one that hangs or crashes fails its
    check, and harms nothing else.
    """
    checked: list[Checked] = []
    waived, context = _waivers(waivers), click.get_current_context()

    def print_row(row: FmuCheckRow) -> None:
        with context.scope(cleanup=False):  # a thread has no --wide of its own
            _print(row)

    for file in files:
        before = os.times()
        report = check_fmu(
            file,
            names=names or None,
            seconds=time_limit,
            waived=waived,
            on_row=None if as_json else print_row,
        )
        after = os.times()
        cpu = sum(after[:4]) - sum(before[:4])
        checked.append((report, after.elapsed - before.elapsed, cpu))
        if not as_json:
            click.echo()
            say(_summary(report))
            if len(checked) < len(files):
                click.echo()
    reports = [report for report, _, _ in checked]
    if as_json:
        found = [data(report) for report in reports]
        click.echo(json.dumps(found if len(found) > 1 else found[0], indent=1, allow_nan=False))
    write(html_file, lambda: _page(checked, arguments))
    write(junit_file, lambda: junit([(report, spent) for report, spent, _ in checked]))
    return max((report.exit_code for report in reports), key=(0, 3, 1).index)


def _summary(report: CheckReport) -> str:
    about = f" (FMI {report.version}, {' and '.join(report.types)})" if report.types else ""
    missing = "; its code cannot be run on this machine" if report.unrunnable else ""
    return f"{report.path}{about}: {report.counts}{missing}"


def _print(row: FmuCheckRow) -> None:
    word = row.status.value
    clause = (
        f" [{row.clause}]" if row.status in (Status.FAILED, Status.WAIVED) and row.clause else ""
    )
    say(
        f"{row.title}: {row.sentence}{clause}",
        begin=f"{_SIGNS[word]} {word:<11}  ",
        indent=" " * 15,
        colour=_COLOURS[word],
    )


def _waivers(texts: tuple[str, ...]) -> dict[str, str]:
    """Return the reasons by names of checks. Raises click.UsageError."""
    waived = {}
    for text in texts:
        name, _, reason = text.partition("=")
        if not name.strip() or not reason.strip():
            wrong = f"--waive {text!r}: expected NAME=REASON, for example --waive 'stop time is respected=our solver needs it'."
            raise click.UsageError(wrong)
        waived[name.strip()] = reason.strip()
    return waived


def _page(checked: Sequence[Checked], arguments: tuple[str, ...]) -> str:
    """Return the page of these reports."""
    from models.results.check import CheckRecord
    from reports.pages.checks import fmus_of
    from reports.render import render_sections
    from validate.store.provenance import gather
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
    names = ", ".join(record.name for record in records)
    return render_sections([fmus_of(records)], title="FMUs under the check", lead=names)


def data(report: CheckReport) -> dict[str, Any]:
    """Return a report as JSON holds it."""
    names = ("type", "claim", "status", "severity", "clause", "sentence", "seconds")
    rows = [
        {"check": row.name}
        | {name: getattr(row, name) for name in names}
        | {"status": row.status.value}
        for row in report.rows
    ]
    head = {
        "file": report.path,
        "fmi": report.version,
        "types": list(report.types),
        "ok": report.ok,
        "exit_code": report.exit_code,
    }
    return {**head, "rows": rows}


def junit(reports: Sequence[tuple[CheckReport, float]]) -> bytes:
    """Return JUnit XML of reports and their seconds; checks waived or not offered are skipped."""
    suites = ElementTree.Element("testsuites", name="touchstone check")
    for report, spent in reports:
        skipped = [row for row in report.rows if row.status in (Status.NOT_OFFERED, Status.WAIVED)]
        suite = ElementTree.SubElement(
            suites,
            "testsuite",
            name=one_line(report.path),
            time=f"{spent:.3f}",
            tests=str(len(report.rows)),
        )
        suite.attrib |= {
            "failures": str(len(report.failures())),
            "skipped": str(len(skipped)),
            "errors": "0",
        }
        for row in report.rows:
            case = ElementTree.SubElement(
                suite,
                "testcase",
                name=row.title,
                classname=one_line(report.path),
                time=f"{row.seconds:.3f}",
            )
            if row.status is Status.FAILED:
                failure = ElementTree.SubElement(
                    case, "failure", message=one_line(row.sentence), type=row.severity
                )
                failure.text = (
                    f"A sound FMU: {one_line(row.claim)}{f' ({row.clause})' if row.clause else ''}"
                )
            elif row in skipped:
                ElementTree.SubElement(case, "skipped", message=one_line(row.sentence))
            elif row.status is Status.ADVICE:
                ElementTree.SubElement(
                    case, "system-out"
                ).text = f"Advice: {one_line(row.sentence)}"
    ElementTree.indent(suites)
    return ElementTree.tostring(suites, encoding="utf-8", xml_declaration=True)
