"""`compare`: two campaigns, regressions first."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import click

from validate.cli.table import one_line, say, table, use_colour, wide_option

_EPILOG = """\b
Examples:
  python -m validate compare runs/before runs/after
  python -m validate compare runs/before runs/after --json

A regression is a worse verdict or outcome, a metric that left its limit, a
dearer plan of the same verdict, a check that failed, or a row that is
gone. Times that differ by more than half and more than a second are listed, but are no regressions.

Exit codes: 0 no regression; 1 at least one; 2 a folder that is no campaign.
"""
_WORDS = {
    "REGRESSION": ("worse", "red"),
    "GONE": ("gone", "red"),
    "SLOWER": ("slower", "yellow"),
    "OTHER": ("other", None),
    "NEW": ("new", None),
    "FASTER": ("faster", "green"),
    "IMPROVEMENT": ("better", "green"),
}


@click.command(epilog=_EPILOG)
@click.argument("before", type=click.Path(path_type=Path), metavar="A")
@click.argument("after", type=click.Path(path_type=Path), metavar="B")
@click.option("--json", "as_json", is_flag=True, help="The differences as JSON on stdout.")
@wide_option
def command(before: Path, after: Path, as_json: bool) -> int:
    """What differs between the campaigns in the folders A (before) and B (after), regressions first."""
    from validate.store.compare import compare

    comparison = compare(_loaded(before), _loaded(after))
    code = 1 if comparison.regressions else 0
    if as_json:
        changes = [
            {
                "kind": _WORDS[change.kind.name][0],
                "where": change.where,
                "what": change.what,
                "before": change.before,
                "after": change.after,
            }
            for change in comparison.changes
        ]
        click.echo(json.dumps({"pairs": comparison.pairs, "changes": changes, "exit_code": code}, indent=1))
        return code
    if comparison.changes:
        cells = [
            [_WORDS[change.kind.name][0], *(one_line(text) for text in (change.where, change.what, change.before, change.after))]
            for change in comparison.changes
        ]
        titles = ["", "where", "what", "before", "after"]
        click.echo(table(titles, cells, drop=("before",), colours=dict(_WORDS.values())), color=use_colour())
        click.echo()
    counts = Counter(_WORDS[change.kind.name][0] for change in comparison.changes)
    told = ", ".join(f"{count} {word}" for word, count in counts.items()) or "none"
    both = "1 row is" if comparison.pairs == 1 else f"{comparison.pairs} rows are"
    click.echo(f"{both} in both campaigns; differences: {told}")
    return code


def _loaded(folder: Path):
    from reports.records.load import ReportError, load

    try:
        stored = load(folder)
    except ReportError as problem:
        raise click.UsageError(str(problem)) from problem
    if stored.campaign is None:  # without it nobody knows which of the records are this campaign's, and which of one before
        (why,) = (item.sentence for item in stored.unreadable if item.path == "campaign.json")
        raise click.UsageError(one_line(f"{folder / 'campaign.json'}: {why}"))
    for item in stored.unreadable:
        say(f"warning: {folder / item.path}: {item.sentence}", err=True)
    if not stored.runs and not stored.examinations:
        raise click.UsageError(f"{folder}: there is no readable record; give the folder of a campaign (it holds campaign.json and runs/).")
    return stored
