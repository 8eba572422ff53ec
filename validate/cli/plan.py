"""`plan`: what `all` would do."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import click

from reports.records.load import other_version
from validate.cli.options import CHOOSING, OUT, PRINTING, SELECTING
from validate.cli.table import in_words, print_table, say, short, warn
from validate.execution.process import usable_cores
from validate.plan.runs import (
    CampaignSettings,
    past_seconds,
    reasons,
    scenes_of,
    select,
    with_stored,
)
from validate.plan.warnings import warnings_of
from validate.store.store import Store
from validate.store.stored import CampaignError
from validate.tasks.task import RunTask

_EPILOG = """\b
Examples:
  python -m validate plan
  python -m validate plan --quick --out runs/quick
  python -m validate plan -k mpcc --table

Exit codes: 0 printed; 2 usage, or nothing selected.
"""


@click.command(epilog=_EPILOG)
@CHOOSING
@SELECTING
@OUT
@PRINTING
def command(as_json: bool, as_table: bool, **options: Any) -> int:
    """What `all` with the same options would run, how long that takes here, what of it is stored already, and why the rest is not.

    --table names each run, and says what the scenes waive. Nothing is run or written.
    """
    return tell_plan(CampaignSettings(**options), as_json=as_json, as_table=as_table)


def tell_plan(settings: CampaignSettings, *, as_json: bool, as_table: bool) -> int:
    """Print it. Raises TouchstoneError."""
    entries, left_out = select(settings)
    scenes = scenes_of(entries)
    warn(warnings_of(scenes.values(), steps=True))
    if sentence := other_version(settings.out):
        raise CampaignError(sentence)
    store = Store(settings.out)
    entries = with_stored(entries, store, settings)
    groups = [
        entry.task.scene_name if isinstance(entry.task, RunTask) else entry.task.kind
        for entry in entries
    ]
    explained = zip(entries, groups, reasons(entries, store), strict=True)
    told = [_Line(entry.task.title, group, entry.task.key, why) for entry, group, why in explained]
    seconds = past_seconds(entries, store)
    limits = {
        name: [f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None]
        for name, scene in scenes.items()
    }
    waived = {name: sentences for name, sentences in limits.items() if sentences}
    unstable = {name: scene.unstable for name, scene in scenes.items() if scene.unstable}
    due = [line for line in told if line.why]
    if as_json:
        data = {
            "runs": [
                {
                    **line._asdict(),
                    "stored": not line.why,
                    "past_cpu_seconds": seconds.get(line.key),
                }
                for line in told
            ],
            "stored": len(told) - len(due),
            "to_run": len(due),
            "left_out": list(left_out),
            "waived": waived,
            "unstable": unstable,
        }
        click.echo(json.dumps(data, indent=1))
        return 0
    (_print_runs if as_table else _print_groups)(told, seconds)
    click.echo()
    if left_out:
        say(f"left out by --quick: {', '.join(left_out)}")
    if as_table:
        for name, sentence in (
            (name, sentence) for name, sentences in waived.items() for sentence in sentences
        ):
            say(f"waived by {name}: {sentence}", indent="  ")
        for name, reason in unstable.items():
            say(
                f"{name} is unstable in the open loop, so that feedback is enough there: {reason}",
                indent="  ",
            )
    for why, count in Counter(line.why for line in due).items():
        say(f"{count} to run: {why}", indent="  ")
    takes = f"; {_duration(due, seconds, settings.jobs or usable_cores())}" if due else ""
    say(f"{len(told) - len(due)} stored, {len(due)} to run{takes}")
    return 0


class _Line(NamedTuple):
    """A run or check. group: its scene, or the kind of the check.

    why: it is run, empty if it is stored.
    """

    name: str
    group: str
    key: str
    why: str


def _print_runs(told: Sequence[_Line], seconds: Mapping[str, float]) -> None:
    rows = [
        [line.name, "run" if line.why else "stored", short(seconds.get(line.key), ".1f"), line.why]
        for line in told
    ]
    print_table(
        ["run or check", "", "CPU s before", "why"],
        rows,
        ("CPU s before",),
        drop=("CPU s before", "why"),
    )


def _print_groups(told: Sequence[_Line], seconds: Mapping[str, float]) -> None:
    rows = []
    for group in dict.fromkeys(line.group for line in told):
        mine = [line for line in told if line.group == group]
        due = [line for line in mine if line.why]
        known = [seconds[line.key] for line in due if line.key in seconds]
        rows.append(
            [
                group,
                str(len(mine)),
                str(len(mine) - len(due)),
                str(len(due)),
                f"{sum(known):.0f}" if known else "",
            ]
        )
    numbers = ("in all", "stored", "to run", "CPU s before")
    print_table(["scene or check", *numbers], rows, numbers, drop=("CPU s before",))


def _duration(due: Sequence[_Line], seconds: Mapping[str, float], jobs: int) -> str:
    """How long it takes here, as far as the folder has seen it before."""
    known = [seconds[line.key] for line in due if line.key in seconds]
    if not known:
        return "how long that takes is not known: nothing like it has run into this folder"
    cores = f", about {in_words(sum(known) / jobs)} on {jobs} cores" if jobs > 1 else ""
    rest = f"; {len(due) - len(known)} never ran here" if len(known) < len(due) else ""
    return f"{len(known)} of them took {in_words(sum(known))} of CPU time when they ran last{cores}{rest}"
