"""What `check` found, as other tools read it: JSON, JUnit XML, SARIF and Markdown."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from reports.records.check_record import IMPORTER, by_importer
from validate.cli.table import one_line
from validate.fmu_check import CheckReport, FmuCheckRow, Status

# Levels of SARIF by severity, and what its results are about: what passed or is not offered is no result.
_LEVELS = {"error": "error", "behaviour": "warning", "advice": "note"}
_TOLD = (Status.FAILED, Status.WAIVED, Status.ADVICE)


def data(report: CheckReport) -> dict[str, Any]:
    """The report as JSON holds it."""
    rows = [
        {
            "check": row.name,
            "type": row.type,
            "claim": row.claim,
            "status": row.status.value,
            "severity": row.severity,
            "clause": row.clause,
            "sentence": row.sentence,
            "seconds": row.seconds,
        }
        for row in report.rows
    ]
    head = {"file": report.path, "fmi": report.version, "types": list(report.types), "ok": report.ok, "exit_code": report.exit_code}
    return {**head, "rows": rows}


def junit(reports: Sequence[tuple[CheckReport, float]]) -> bytes:
    """JUnit XML, of reports and the seconds each took: what was measured is the message of a failure; what is waived or not offered is skipped."""
    suites = ElementTree.Element("testsuites", name="touchstone check")
    for report, spent in reports:
        skipped = [row for row in report.rows if row.status in (Status.NOT_OFFERED, Status.WAIVED)]
        suite = ElementTree.SubElement(
            suites,
            "testsuite",
            name=one_line(report.path),
            time=f"{spent:.3f}",
            tests=str(len(report.rows)),
            failures=str(len(report.failures())),
            skipped=str(len(skipped)),
            errors="0",
        )
        for row in report.rows:
            case = ElementTree.SubElement(suite, "testcase", name=row.title, classname=one_line(report.path), time=f"{row.seconds:.3f}")
            if row.status is Status.FAILED:
                failure = ElementTree.SubElement(case, "failure", message=one_line(row.sentence), type=row.severity)
                failure.text = f"A sound FMU: {one_line(row.claim)}{f' ({row.clause})' if row.clause else ''}"
            elif row in skipped:
                ElementTree.SubElement(case, "skipped", message=one_line(row.sentence))
            elif row.status is Status.ADVICE:
                ElementTree.SubElement(case, "system-out").text = f"Advice: {one_line(row.sentence)}"
    ElementTree.indent(suites)
    return ElementTree.tostring(suites, encoding="utf-8", xml_declaration=True)


def sarif(reports: Sequence[CheckReport]) -> str:
    """SARIF 2.1.0 (OASIS): a rule a check, a result for each that failed, was waived, or gave advice."""
    told = [(report, row) for report in reports for row in report.rows if row.status in _TOLD]
    rules = {
        _identity(row): {
            "id": _identity(row),
            "name": row.name,
            "shortDescription": {"text": f"A sound FMU: {row.claim}." if row.claim else row.name},
            "defaultConfiguration": {"level": _LEVELS[row.severity]},
            "properties": {"clause": row.clause},
        }
        for _, row in told
    }
    driver = {"name": "touchstone check", "version": version("touchstone-contact"), "rules": list(rules.values())}
    run = {"tool": {"driver": driver}, "results": [_result(report, row) for report, row in told]}
    schema = "https://json.schemastore.org/sarif-2.1.0.json"
    return json.dumps({"$schema": schema, "version": "2.1.0", "runs": [run]}, indent=1)


def _result(report: CheckReport, row: FmuCheckRow) -> dict[str, Any]:
    clause = f" [{row.clause}]" if row.clause else ""
    where = {"physicalLocation": {"artifactLocation": {"uri": quote(Path(report.path).as_posix())}}}
    result = {
        "ruleId": _identity(row),
        "level": _LEVELS[row.severity],
        "message": {"text": f"{row.title}: {one_line(row.sentence)}{clause}"},
        "locations": [where],
    }
    if row.status is Status.WAIVED:
        result["suppressions"] = [{"kind": "external", "justification": one_line(row.sentence)}]
    return result


def _identity(row: FmuCheckRow) -> str:
    """The check's name as a rule is named: letters, digits and hyphens."""
    return "-".join("".join(letter if letter.isalnum() else " " for letter in row.name.replace("'", "")).lower().split())


def markdown(reports: Sequence[CheckReport], command: str) -> str:
    """A table an FMU, what failed first; with the file's SHA-256 and what it was checked by, so that it can be cited."""
    order = (Status.FAILED, Status.WAIVED, Status.ADVICE, Status.PASSED, Status.NOT_OFFERED)
    parts = []
    for report in reports:
        digest = hashlib.sha256(Path(report.path).read_bytes()).hexdigest()
        about = f"FMI {report.version}, {' and '.join(report.types)}. " if report.types else ""
        rows = sorted((row for row in report.rows if not row.name.startswith(IMPORTER)), key=lambda row: order.index(row.status))
        cells = [[_status(row), *map(_cell, (row.title, row.sentence, row.clause))] for row in rows]
        table = ["| outcome | check | what was found | clause |", "|---|---|---|---|"]
        table += [f"| {' | '.join(row)} |" for row in cells]
        table += _importers(report)
        parts += [f"## {_cell(Path(report.path).name)}", "", f"{about}{report.counts}. SHA-256 `{digest}`.", "", *table, ""]
    origin = f"touchstone {version('touchstone-contact')}, {platform.system()} {platform.machine()}, against FMI 2.0.4 and 3.0.2"
    return "\n".join([*parts, f"Checked by `{one_line(command)}` ({origin}).", ""])


def _importers(report: CheckReport) -> list[str]:
    """A table importer x interface; nothing where none was asked."""
    table = []
    for importer, cells in by_importer(report.rows).items():
        told = [f"{cells[kind].status.value}: {cells[kind].sentence}" if kind in cells else "-" for kind in ("ME", "CS", "")]
        table.append(f"| {' | '.join(map(_cell, [importer, *told]))} |")
    return ["", "| importer | Model Exchange | Co-Simulation | file |", "|---|---|---|---|", *table] if table else []


def _status(row: FmuCheckRow) -> str:
    return f"**{row.status.value}** ({row.severity})" if row.status is Status.FAILED else row.status.value


def _cell(text: str) -> str:
    """Text from anywhere in a cell of Markdown: nothing in it is a mark."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]<>|#!" else letter for letter in one_line(text))
