"""`account`: where the seconds of a campaign went, from its records.

    python -m validate all -j 2 --out runs/cold; python -m benchmarks account runs/cold

A run tells how long each part of it took, from the start of its process to its record
(validate.tasks.profile). What another run made for it - a leg, an FMU - counts where it was made,
once. Seconds are of the wall: with no more tasks at a time than cores they are those of a core, but
for what waits for the disk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import click

from benchmarks.options import campaign_argument
from models.results.run import RunRecord
from reports.load import load
from validate.cli.table import table

# Laps of a run's profile that are one cost, and what that is.
PARTS = {
    "processes start, import": ("start", "imports"),
    "scenes and equations of motion": ("scene",),
    "kernels compiled": ("compile",),
    "methods opened": ("opening",),
    "Pyomo models built": ("build",),
    "models translated": ("translate",),
    "functions evaluated": ("evaluate",),
    "Ipopt and linear algebra": ("linear_algebra",),
    "rest of solving": ("solve_rest",),
    "FMUs exported": ("fmu_build",),
    "replay and verdict": ("replay",),
    "certificates": ("certificate",),
    "plans and replays written": ("writing",),
    "legs taken and stored": ("shared",),
    "records": ("record",),
}
SECONDS = ("build", "translate", "evaluate", "linear_algebra", "stage", "replay")


def by_part(profiles: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Seconds of all runs by part [s]; laps that have no part under their own name."""
    total: Counter[str] = Counter()
    for profile in profiles:
        total.update(profile)
    known = {part: sum(total.pop(lap, 0.0) for lap in laps) for part, laps in PARTS.items()}
    return {**known, **total}


def by_method(runs: Iterable[RunRecord]) -> dict[str, Counter[str]]:
    """Of each method the number of its stages, their iterations, and SECONDS [s].

    A stage that several runs share counts once, where it was made; one that was refused does not.
    """
    found: dict[str, Counter[str]] = {}
    for run in runs:
        for stage in run.stages:
            if stage.shared_from or stage.outcome == "refused":
                continue
            seconds = {name: getattr(stage.seconds, name) for name in SECONDS}
            found.setdefault(stage.method, Counter()).update(
                {"stages": 1, "iterations": stage.iterations, **seconds}
            )
    return found


@click.command()
@campaign_argument
def command(folder: Path) -> int:
    """Where the seconds of a campaign went."""
    stored = load(folder)
    runs = stored.runs
    parts = {
        name: seconds for name, seconds in by_part(run.profile for run in runs).items() if seconds
    }
    for kind in sorted({item.kind for item in stored.checks}):
        parts[f"checks: {kind}"] = sum(
            item.wall_seconds for item in stored.checks if item.kind == kind
        )
    total = sum(parts.values())
    rows = [
        [name, f"{seconds:.0f}", f"{100.0 * seconds / total:.1f} %"]
        for name, seconds in parts.items()
    ]
    click.echo(table(["part", "s", "share"], [*rows, ["all", f"{total:.0f}", ""]]))
    cpu = sum(item.cpu_seconds for item in (*runs, *stored.checks))
    click.echo(
        f"\n{len(runs)} runs and {len(stored.checks)} checks used {cpu:.0f} CPU s in their own processes, compilers not counted.\n"
    )
    columns = ("stages", "iterations", *SECONDS)
    methods = sorted(by_method(runs).items(), key=lambda item: -item[1]["stage"])
    click.echo(
        table(
            ["method", *columns],
            [
                [name, *(f"{figures[column]:.0f}" for column in columns)]
                for name, figures in methods
            ],
        )
    )
    return 0
