"""`plan`: what `all` would do."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import click

from validate.cli.campaign_options import campaign_options
from validate.cli.doubts import tell_doubts
from validate.cli.table import one_line, table

if TYPE_CHECKING:
    from validate.chosen import Settings

_EPILOG = """\b
Examples:
  python -m validate plan
  python -m validate plan --quick --out runs/quick
  python -m validate plan -k mpcc --json

\b
Exit codes: 0 told; 2 usage, or nothing selected.
"""


@click.command(epilog=_EPILOG)
@campaign_options
@click.option("--json", "as_json", is_flag=True, help="As JSON on stdout.")
def command(as_json: bool, **options: Any) -> int:
    """What `all` with the same options would run, what of it is stored already, and why the rest is not. Nothing is run or written."""
    from validate.chosen import Settings

    return tell_plan(Settings(**options), as_json)


def tell_plan(settings: Settings, as_json: bool) -> int:
    """Print it. Raises TouchstoneError."""
    from validate.chosen import Entry, reasons, select, with_stored
    from validate.store import Store
    from validate.stored import only_last_failed

    entries, left_out = select(settings)
    tell_doubts((entry.scene for entry in entries if isinstance(entry, Entry)), steps=True)
    store = Store(settings.out)
    entries = with_stored(entries, store, settings)
    if settings.last_failed:
        entries = only_last_failed(entries, store)
    told = list(zip(entries, reasons(entries, store), strict=True))
    stored = sum(entry.stored is not None for entry in entries)
    if as_json:
        cells = [{"cell": entry.cell.title, "key": entry.cell.key, "stored": entry.stored is not None, "why": why} for entry, why in told]
        data = {"cells": cells, "stored": stored, "to_run": len(entries) - stored, "left_out": list(left_out)}
        click.echo(json.dumps(data, indent=1))
        return 0
    click.echo(table(["cell", "", "why"], [[one_line(entry.cell.title), "run" if why else "stored", why] for entry, why in told]))
    click.echo()
    if left_out:
        click.echo(f"left out by --quick: {', '.join(left_out)}")
    for why, count in Counter(why for _, why in told if why).items():
        click.echo(f"{count} to run: {why}")
    click.echo(f"{stored} stored, {len(entries) - stored} to run")
    return 0
