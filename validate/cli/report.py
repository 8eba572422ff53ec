"""`report`: rebuild what is told of a campaign from what is stored of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click


@click.command(
    epilog="""\b
Examples:
  python -m validate report runs/all
  python -m validate report runs/all --json

\b
Exit codes: 0 rebuilt; 2 a folder that is no campaign; 3 it cannot be written.
"""
)
@click.argument("folder", type=click.Path(path_type=Path), default="runs/all", metavar="[DIR]")
@click.option("--split", is_flag=True, help="Pages in the folder DIR/report instead of one file.")
@click.option("--json", "as_json", is_flag=True, help="The results as JSON on stdout.")
def command(folder: Path, split: bool, as_json: bool) -> int:
    """Rebuild results.csv, examinations.csv, violation.csv and report.html of the campaign in DIR (runs/all) from its records; no solver is needed."""
    from reports.kept import kept
    from validate.execution.process import ROOT
    from validate.store.results import write_or_remove
    from validate.tasks.plugins import DEFAULT

    sources = [*sorted((ROOT / "validate").glob("*.py")), Path(__file__)]
    told = json.loads(kept(folder, "results", lambda: json.dumps(_tables(folder)), sources=sources))
    for name, text in told["files"].items():
        write_or_remove(folder / name, text)
    report = (DEFAULT.write_pages if split else DEFAULT.write_report)(folder)
    if told["missing"]:
        click.echo(
            f"{told['missing']} of {told['cells']} cells have no readable record; the command of the campaign runs them: {told['command']}",
            err=True,
        )
    if as_json:
        click.echo(json.dumps({**told["rows"], "report": str(report)}, indent=1, allow_nan=False))
    else:
        click.echo(f"report:  {report}")
        click.echo(f"results: {folder / 'results.csv'}")
    return 0


def _tables(folder: Path) -> dict[str, Any]:
    """What is told beside the report: the texts of the tables, their rows, and how many cells are missing. Raises CampaignError."""
    from reports.records.load import ReportError, Stored
    from reports.render import outlined
    from validate.execution.campaign import EXAMINATIONS, RESULTS, VIOLATION
    from validate.store.results import examination_rows, examinations_text, results_text, rows
    from validate.store.stored import campaign_of
    from validate.tasks.paper import violation_text

    try:
        stored = outlined(folder)  # a pipeline that ran in parts is one row, as in the campaign's own table
    except ReportError:
        stored = Stored("", None, (), (), (), 0)
    campaign = stored.campaign or campaign_of(folder)  # which says why there is none
    records, examinations = stored.runs, stored.examinations
    found = sum(map(len, stored.parts)) + len(examinations)
    return {
        "files": {
            RESULTS: results_text(records),
            EXAMINATIONS: examinations_text(examinations),
            VIOLATION: violation_text(campaign.violation),
        },
        "rows": {"results": rows(records), "examinations": examination_rows(examinations)},
        "missing": len(campaign.keys) - found,
        "cells": len(campaign.keys),
        "command": campaign.command,
    }
