"""`plan`: what `all` would do."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import click

from validate.cli.campaign_options import campaign_options
from validate.cli.table import one_line, say, table, wide_option
from validate.cli.warnings import print_warnings

if TYPE_CHECKING:
    from validate.plan.runs import CampaignSettings

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
    """What `all` with the same options would run, what of it is stored already, and why the rest is not; and which limits its scenes waive.

    Nothing is run or written.
    """
    from validate.plan.runs import CampaignSettings

    return tell_plan(CampaignSettings(**options), as_json)


def tell_plan(settings: CampaignSettings, as_json: bool) -> int:
    """Print it. Raises TouchstoneError."""
    from validate.plan.runs import PlannedRun, only_last_failed, reasons, select, with_stored
    from validate.store.store import Store
    from validate.store.stored import earlier_schema

    entries, left_out = select(settings)
    scenes = {entry.scene.name: entry.scene for entry in entries if isinstance(entry, PlannedRun)}
    print_warnings(scenes.values(), steps=True)
    if sentence := earlier_schema(settings.out):
        say(f"warning: {sentence}", err=True)
    store = Store(settings.out)
    entries = with_stored(entries, store, settings)
    if settings.last_failed:
        entries = only_last_failed(entries, store)
    told = list(zip(entries, reasons(entries, store), strict=True))
    stored = sum(entry.stored is not None for entry in entries)
    waived = {
        name: [f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None]
        for name, scene in scenes.items()
        if any(limit.value is None for limit in scene.limits)
    }
    unstable = {name: scene.unstable for name, scene in scenes.items() if scene.unstable}
    if as_json:
        cells = [{"cell": entry.task.title, "key": entry.task.key, "stored": entry.stored is not None, "why": why} for entry, why in told]
        data = {
            "cells": cells,
            "stored": stored,
            "to_run": len(entries) - stored,
            "left_out": list(left_out),
            "waived": waived,
            "unstable": unstable,
        }
        click.echo(json.dumps(data, indent=1))
        return 0
    click.echo(table(["cell", "", "why"], [[one_line(entry.task.title), "run" if why else "stored", why] for entry, why in told]))
    click.echo()
    if left_out:
        click.echo(f"left out by --quick: {', '.join(left_out)}")
    for name, limits in waived.items():
        for limit in limits:
            say(f"waived by {name}: {limit}")
    for name, reason in unstable.items():
        say(f"{name} is unstable in the open loop, so that feedback is enough there: {reason}")
    for why, count in Counter(why for _, why in told if why).items():
        click.echo(f"{count} to run: {why}")
    click.echo(f"{stored} stored, {len(entries) - stored} to run")
    return 0
