"""`--dry-run` of `all` and `run`: try this machine and print the runs of a campaign."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import click

from models.errors import MachineError
from validate.campaign.campaign import checked_selection
from validate.campaign.runs import (
    CampaignSettings,
    PlannedTask,
    past_seconds,
    reasons,
    scenes_of,
    with_stored,
)
from validate.campaign.warnings import is_of_bank, scene_figures, warnings_of
from validate.cli.table import in_words, print_table, say, short, warn
from validate.cli.trials import try_machine
from validate.processes.process import usable_cores
from validate.store.store import Store
from validate.tasks.path import refused
from validate.tasks.task import RunTask

# States of a run, and columns of the table.
_STORED = "stored"
_REFUSED = "not applicable"
_DUE = "to run"
# Names of runs of several scenes listed before "and N more".
_NAMED = 3


def print_dry_run(settings: CampaignSettings, *, as_json: bool, as_table: bool) -> int:
    """Print the trials of this machine and the planned runs; return the exit code.

    3: a trial failed; 2: instances of foreign plans are refused; else 0. Nothing is run or written.
    Raises TouchstoneError.
    """
    entries, left_out = checked_selection(settings)
    store = Store(settings.out)
    entries = with_stored(entries, store, settings)
    findings = []
    for finding in try_machine(settings.out):
        findings.append(finding)
        if not as_json:
            begin, colour = ("works: ", "green") if finding.works else ("fails: ", "red")
            say(f"{finding.name}: {finding.sentence}", begin=begin, indent="  ", colour=colour)
    failing = [finding.name for finding in findings if not finding.works]
    code = MachineError.exit_code if failing else 2 if settings.refused else 0
    scenes = scenes_of(entries)
    warn([*settings.refused, *warnings_of(scenes.values(), steps=True)])
    own: dict[str, tuple[str, ...]] = {}
    with suppress(MachineError):  # no compiler: a trial above fails
        own = {
            name: scene_figures(scene) for name, scene in scenes.items() if not is_of_bank(scene)
        }
    lines = _lines(entries, store)
    count = Counter(line.state for line in lines)
    if as_json:
        data = {
            "machine": [finding._asdict() for finding in findings],
            "scenes": own,
            "runs": [line._asdict() for line in lines],
            "stored": count[_STORED],
            "not_applicable": count[_REFUSED],
            "to_run": count[_DUE],
            "left_out": list(left_out),
            "exit_code": code,
        }
        click.echo(json.dumps(data, indent=1))
        return code
    for name, sentences in own.items():
        for sentence in sentences:
            say(sentence, begin=f"{name}: ", indent="  ")
    click.echo()
    (_print_runs if as_table else _print_scenes)(lines)
    click.echo()
    if left_out:
        say(f"left out by --quick: {', '.join(left_out)}")
    groups: dict[tuple[str, str], list[_Line]] = {}
    for line in lines:
        if line.why:
            groups.setdefault((line.state, line.why), []).append(line)
    for (state, why), alike in groups.items():
        say(f"{len(alike)} {state}: {_listed(alike)}: {why}", indent="  ")
    refusals = f", {count[_REFUSED]} {_REFUSED}" if count[_REFUSED] else ""
    takes = _duration(lines, settings.jobs or usable_cores(), settings.time_limit)
    say(f"{count[_STORED]} {_STORED}, {count[_DUE]} {_DUE}{refusals}{takes}")
    if failing:
        say(f"the campaign needs what fails here: {', '.join(failing)}")
    return code


class _Line(NamedTuple):
    """A run or check.

    - scene: its scene, or the kind of the check
    - why: reason of its state, "" if it is stored
    - past_cpu_seconds: CPU time of its last run into this folder
    """

    name: str
    scene: str
    key: str
    state: str
    why: str
    past_cpu_seconds: float | None


def _lines(entries: Sequence[PlannedTask], store: Store) -> list[_Line]:
    seconds = past_seconds(entries, store)
    lines = []
    for entry, why in zip(entries, reasons(entries, store), strict=True):
        task, refusal = entry.task, _refusal(entry)
        lines.append(
            _Line(
                name=task.title,
                scene=task.scene_name if isinstance(task, RunTask) else task.kind,
                key=task.key,
                state=_REFUSED if refusal else _DUE if why else _STORED,
                why=refusal or why,
                past_cpu_seconds=seconds.get(task.key),
            )
        )
    return lines


def _refusal(entry: PlannedTask) -> str:
    """Return the reason why a method of this run does not apply to its scene, else ""."""
    if entry.loaded is None:
        return ""
    try:
        stages = refused(entry.loaded.scene, entry.loaded.plan)
    except Exception:  # noqa: BLE001 - a faulty method of the user: its run crashes and is recorded
        return ""
    return stages[0][2].partition(": ")[2] if stages else ""


def _print_runs(lines: Sequence[_Line]) -> None:
    rows = [
        [line.name, line.state, short(line.past_cpu_seconds, ".1f"), line.why] for line in lines
    ]
    titles = ["run or check", "", "CPU s before", "why"]
    print_table(titles, rows, ("CPU s before",), drop=("CPU s before", "why"))


def _print_scenes(lines: Sequence[_Line]) -> None:
    rows = []
    for scene in dict.fromkeys(line.scene for line in lines):
        mine = [line for line in lines if line.scene == scene]
        states = Counter(line.state for line in mine)
        known = [line.past_cpu_seconds for line in mine if line.past_cpu_seconds is not None]
        before = f"{sum(known):.0f}" if known else ""
        rows.append([scene, *(str(states[name]) for name in (_STORED, _REFUSED, _DUE)), before])
    numbers = (_STORED, _REFUSED, _DUE, "CPU s before")
    print_table(["scene or check", *numbers], rows, numbers, drop=("CPU s before",))


def _listed(lines: Sequence[_Line]) -> str:
    """Return the names of runs: pipelines alone if all are of one scene."""
    scenes = {line.scene for line in lines if " x " in line.name}
    names = [
        line.name.removeprefix(f"{line.scene} x ") if len(scenes) == 1 else line.name
        for line in lines
    ]
    shown = names if len(scenes) == 1 else names[:_NAMED]
    more = f" and {len(names) - len(shown)} more" if len(shown) < len(names) else ""
    return f"{', '.join(shown)}{more}"


def _duration(lines: Sequence[_Line], jobs: int, time_limit: float) -> str:
    """Return the expected time, from earlier runs into the same folder and the time limit [s]."""
    due = [line for line in lines if line.state == _DUE]
    known = [line.past_cpu_seconds for line in due if line.past_cpu_seconds is not None]
    if not due:
        return ""
    new, cores = len(due) - len(known), f"on {jobs} core{'s' if jobs > 1 else ''}"
    most = f"{in_words(new * time_limit / min(jobs, new))} {cores}" if new else ""
    bound = f"at most {most}, as each is ended after {time_limit:g} s"
    if not known:
        return f"; none of these ran into this folder before: {bound}"
    before = f", about {in_words(sum(known) / jobs)} {cores}" if jobs > 1 else ""
    rest = f"; {new} never ran here: {bound}" if new else ""
    return f"; {len(known)} of them took {in_words(sum(known))} of CPU time when they ran last{before}{rest}"
