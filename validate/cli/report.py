"""`report`: rebuild what is told of a campaign from what is stored of it."""

from __future__ import annotations

import json
from pathlib import Path

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
    from reports.collected import collected
    from reports.examination_record import divided
    from validate.campaign import EXAMINATIONS, RESULTS, VIOLATION, stored_campaign
    from validate.results import examination_rows, rows, write_examinations, write_results
    from validate.tools import DEFAULT
    from validate.violation import write_violation

    campaign, stored = stored_campaign(folder)
    parts, examinations = divided(stored)
    records = collected(parts)  # a pipeline that ran in parts is one row, as in the campaign's own table
    write_results(folder / RESULTS, records)
    write_examinations(folder / EXAMINATIONS, examinations)
    write_violation(folder / VIOLATION, campaign.violation)
    report = (DEFAULT.write_pages if split else DEFAULT.write_report)(folder)
    missing = len(campaign.keys) - len(stored)
    if missing:
        click.echo(
            f"{missing} of {len(campaign.keys)} cells have no readable record; the command of the campaign runs them: {campaign.command}",
            err=True,
        )
    if as_json:
        click.echo(
            json.dumps(
                {"results": rows(records), "examinations": examination_rows(examinations), "report": str(report)}, indent=1, allow_nan=False
            )
        )
    else:
        click.echo(f"report:  {report}")
        click.echo(f"results: {folder / RESULTS}")
    return 0
