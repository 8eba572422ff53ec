"""`doctor`: what this machine can do, tried."""

from __future__ import annotations

import json
from pathlib import Path

import click

from validate.cli.table import say

_EPILOG = """\b
Examples:
  python -m validate doctor
  python -m validate doctor --out /data/campaign

Exit codes: 0 the main job works here; 3 something it needs does not.
"""
_COLOURS = {"works": "green", "not installed": "yellow", "does not work": "red"}


@click.command(epilog=_EPILOG)
@click.option(
    "--out", type=click.Path(path_type=Path), default="runs/all", show_default=True, metavar="DIR", help="The folder a campaign would use."
)
@click.option("--json", "as_json", is_flag=True, help="The findings as JSON on stdout.")
def command(out: Path, as_json: bool) -> int:
    """Try each thing the main job needs - compiler, cache, Ipopt, PyTorch, an FMU in a child, the store - and say how to mend what fails."""
    from validate.doctor import State, examine_machine

    findings = []
    for finding in examine_machine(out):
        findings.append(finding)
        if not as_json:
            begin, indent = f"{finding.state.value:13}  ", " " * 15
            say(f"{finding.name}: {finding.sentence}", begin=begin, indent=indent, colour=_COLOURS[finding.state.value])
            if finding.remedy:
                say(f"to mend it: {finding.remedy}", begin=indent, indent=indent)
    code = 3 if any(finding.state is State.BROKEN for finding in findings) else 0
    if as_json:
        rows = [
            {
                "name": finding.name,
                "state": finding.state.value,
                "sentence": finding.sentence,
                "remedy": finding.remedy,
                "seconds": finding.seconds,
            }
            for finding in findings
        ]
        click.echo(json.dumps({"findings": rows, "exit_code": code}, indent=1))
    elif code:
        say("`all` will not work here until what is marked 'does not work' is mended")
    else:
        say("`all` works here: python -m validate all")
    return code
