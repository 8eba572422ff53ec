"""`run`: run a campaign that a file describes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from validate.campaign.read import read_campaign
from validate.campaign.schema import CampaignFile
from validate.cli.all import run_and_tell
from validate.cli.dry_run import print_dry_run
from validate.cli.options import DRY_RUN, ENDING, OUT_OF_FILE, PRINTING, SELECTING
from validate.store.provenance import command_line

_EPILOG = """\b
Examples:
  python -m validate run stiffness.toml --dry-run
  python -m validate run stiffness.toml --out runs/stiffness
  python -m validate run --schema > campaign.schema.json

docs/campaigns has examples, docs/campaigns.md describes every key. DIR gets
the files of `all`, a copy campaign.toml, and resolved.toml with every choice
filled in. Changes of a scene or an option are part of a run's key.

Exit codes: 0 every required check passed; 1 one failed; 2 mistakes in the
file (all of them are named), or nothing selected; 3 a system requirement is
missing; 130 interrupted.
"""


@click.command(epilog=_EPILOG)
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="CAMPAIGN.toml")
@SELECTING
@ENDING
@DRY_RUN
@OUT_OF_FILE
@click.option("--schema", is_flag=True, help="Print the JSON Schema of campaign files for editors.")
@PRINTING
@click.pass_obj
def command(
    arguments: tuple[str, ...],
    file: Path | None,
    dry_run: bool,
    schema: bool,
    as_json: bool,
    as_table: bool,
    **options: Any,
) -> int:
    """Run a campaign file: scenes with changed and swept numbers, pipelines and eps schedules."""
    if schema:
        data = {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            **CampaignFile.model_json_schema(),
        }
        click.echo(json.dumps(data, indent=1))
        return 0
    if file is None:
        raise click.UsageError("give a campaign file, such as docs/campaigns/stiffness.toml.")
    settings = read_campaign(file, command=command_line(arguments), **options)
    if dry_run:
        return print_dry_run(settings, as_json=as_json, as_table=as_table)
    return run_and_tell(settings, arguments, as_json=as_json, as_table=as_table)
