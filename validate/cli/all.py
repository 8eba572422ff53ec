"""`all`: the campaign."""

from __future__ import annotations

from typing import Any

import click

from reports.rule_text import RESULTS, RULE
from validate.cli.options import result_options, running_options
from validate.cli.running import run_and_tell
from validate.plan.runs import CampaignSettings
from validate.store.provenance import command_line

_RULE = "\n\n".join(["A campaign fails (exit code 1) if", *(f"- {line}{'.' if line == RULE[-1] else ';'}" for line in RULE), *RESULTS])
_EPILOG = f"""{_RULE}

What is stored is used again, except runs that crashed, ran out of a shorter
time limit than they would have now, or were to be run anew (--fresh,
--last-failed) when that was interrupted. The key of a run is the hash of its
content: scene, pipeline with all options, our sources, library versions.

\b
Examples:
  python -m validate all
  python -m validate all --quick
  python -m validate all -k FMU       (our FMUs, checked)
  python -m validate all -k stress    (the stress cases)
  python -m validate all -k "strict and not relaxed"
  python -m validate all --scene my/own_scene.py
  python -m validate all --last-failed

Exit codes: 0 every required check passed; 1 one failed; 2 usage,
configuration or nothing selected; 3 a system requirement is missing;
130 interrupted.
"""


@click.command(epilog=_EPILOG)
@running_options
@result_options
@click.pass_obj
def command(arguments: tuple[str, ...], as_json: bool, as_table: bool, **options: Any) -> int:
    """Run every scene by every pipeline, replay and score each plan, write the report.

    Progress goes to stderr; to stdout what was found, why runs fail, and the path of the report. DIR then holds report.html with its
    pages, results.csv (one row a stage), checks.csv (one row a check, such as that of a scene's FMU), violation.csv,
    starts.csv (one row a start), front.csv (one row a terminal tolerance), campaign.json and, for each run, runs/<key>.

    A part (-k, --scene, --quick, --last-failed) leaves the other runs of DIR in these tables and in the report.
    """
    settings = CampaignSettings(command=command_line(arguments), **options)
    return run_and_tell(settings, arguments, as_json=as_json, as_table=as_table)
