"""`report`: rebuild the tables and pages of a campaign from its records."""

from __future__ import annotations

import json
from pathlib import Path

import click

from models.errors import MachineError
from reports.load import ReportError, Stored, load
from reports.render import write_report, write_single
from validate.campaign.results import check_rows, rows, write_tables
from validate.campaign.stored import campaign_of
from validate.cli.table import say
from validate.store.store import Store


@click.command(
    epilog="""\b
Examples:
  python -m validate report runs/all
  python -m validate report runs/all --single-file
  python -m validate report runs/all --json

Exit codes: 0 rebuilt; 2 a folder that is no campaign; 3 it cannot be written.
"""
)
@click.argument("folder", type=click.Path(path_type=Path), default="runs/all", metavar="[DIR]")
@click.option(
    "--single-file", is_flag=True, help="Write one file, DIR/single.html, instead of pages."
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(min=1),
    help="Draw pages in N processes.  [default: the number of cores]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
def command(folder: Path, single_file: bool, jobs: int | None, as_json: bool) -> int:
    """Rebuild the tables (CSV) and report.html of the campaign in DIR (runs/all) from its records.

    report.html leads to a page for each scene and each run in DIR/pages.
    """
    try:
        stored = load(folder)
    except ReportError:
        stored = Stored(None, ())
    if not (stored.campaign or stored.runs or stored.checks):
        campaign_of(folder)  # raises with the reason
    # If no record is readable, the old tables may be the only results.
    if stored.runs or stored.checks or not (stored.campaign and stored.campaign.keys):
        write_tables(
            folder, stored.runs, stored.checks, stored.campaign.violation if stored.campaign else ()
        )
    try:
        report = write_single(folder) if single_file else write_report(folder, jobs)
    except ReportError as error:  # `reports` does not import our errors
        raise MachineError(str(error)) from error
    for line in _lacking(stored, folder):
        say(line, err=True)
    if as_json:
        found = {
            "results": rows(stored.runs),
            "checks": check_rows(stored.checks),
            "report": str(report),
        }
        click.echo(json.dumps(found, indent=1, allow_nan=False))
    else:
        click.echo(f"report:  {report}")
        click.echo(f"results: {folder / 'results.csv'}")
    return 0


def _lacking(stored: Stored, folder: Path) -> list[str]:
    """Return a sentence for each part that could not be rebuilt; empty if none is missing."""
    there, campaign = len(stored.runs) + len(stored.checks), stored.campaign
    lines = []
    if campaign is None:
        broken = f"campaign.json cannot be read: the report shows the {there} records that can; the command that made them writes it anew."
        lines.append(broken)
    elif there < len(campaign.keys):
        missing = (
            f"{len(campaign.keys) - there} of {len(campaign.keys)} runs have no readable record"
        )
        lines.append(
            f"{missing}; the command of the campaign, with --out {folder}, runs them: {campaign.command}"
        )
    store = Store(folder)
    for run in stored.runs:
        if name := store.damaged_file(run.key):
            file = store.runs / run.key / name
            lines.append(
                f"{run.title}: {file} is gone or cut off; remove that folder, and the command of the campaign runs it again."
            )
    return lines
