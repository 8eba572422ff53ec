"""`strangers`: see the package's docstring."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from benchmarks.options import COUNT, POSITIVE, out_option, seed_option
from benchmarks.results import as_text
from benchmarks.strangers.families import FAMILIES
from benchmarks.strangers.trial import CRASH, HOLD, REFUSED, Row
from formulations.pipelines import pipeline_names
from validate.processes.disk import make_folder, write_durably
from validate.processes.isolated import Limits, run_isolated

STANDARD = ("softplus_dc+strict", "mpcc", "best_exact")
COLUMNS = (
    "scene", "family", "length", "mass", "stiffness", "omega_h", "pipeline", "outcome", "verdict",
    "reason", "cost", "witness", "seconds", "words",
)  # fmt: skip
# Seconds of a child beside its pipelines: the draw, compilers, replays.
_BESIDE = 240.0
_MEMORY = 64 * 1024**3  # PyTorch maps a lot that it never uses


def tried(seed: int, number: int, pipelines: Sequence[str], time_limit: float) -> list[Row]:
    """Return the rows of a scene, planned and judged in a child process."""
    request = {
        "seed": seed,
        "number": number,
        "pipelines": list(pipelines),
        "time_limit": time_limit,
    }
    # A failure is run once more, in units of its own size.
    limits = Limits(seconds=_BESIDE + 2.0 * len(pipelines) * time_limit, memory=_MEMORY)
    family = list(FAMILIES)[number % len(FAMILIES)]
    name = f"{family}_{seed}_{number}"
    done = run_isolated(
        "benchmarks.strangers.trial:attempt", request, limits=limits, what=name, ours=True
    )
    if done.ok:
        return done.value
    row = {"scene": name, "family": family, "verdict": "", "reason": CRASH, "words": done.sentence}
    return [{**row, "pipeline": pipeline} for pipeline in pipelines]


def summary(rows: Sequence[Row]) -> str:
    """Return a table of the pipelines, and how many scenes have a plan that holds."""
    kinds = sorted({row["reason"] for row in rows if row["reason"]})
    table = []
    for name in dict.fromkeys(row["pipeline"] for row in rows):
        of = [row for row in rows if row["pipeline"] == name]
        reasons = Counter(row["reason"] for row in of if row["reason"])
        verdicts = Counter(row["verdict"] for row in of)
        applies = len(of) - verdicts[REFUSED]
        table.append(
            (name, applies, *(verdicts[word] for word in HOLD), *(reasons[kind] for kind in kinds))
        )
    scenes = {row["scene"] for row in rows}
    solved = {row["scene"] for row in rows if row["verdict"] in HOLD}
    text = as_text(("pipeline", "scenes", *HOLD, *kinds), table)
    share = f"{len(solved)} of {len(scenes)} scenes have a plan that holds, or holds with feedback"
    return f"{text}\n{share}\n"


def as_csv(rows: Sequence[Row]) -> str:
    """Return the rows as CSV."""
    file = io.StringIO()
    writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: row.get(name, "") for name in COLUMNS} for row in rows)
    return file.getvalue()


@click.command()
@seed_option
@click.option("--count", type=COUNT, default=24, show_default=True, help="Scenes to draw.")
@click.option("--first", type=click.IntRange(min=0), default=0, help="Number of the first scene.")
@click.option(
    "--pipeline",
    "pipelines",
    multiple=True,
    type=click.Choice(pipeline_names()),
    default=STANDARD,
    show_default=True,
    metavar="NAME",
)
@click.option(
    "--time-limit",
    type=POSITIVE,
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="Wall time of one pipeline on one scene.",
)
@out_option
def command(
    seed: int, count: int, first: int, pipelines: tuple[str, ...], time_limit: float, out: Path
) -> int:
    """Scenes drawn by a seed, by the standard pipelines: what has a plan that holds, and why not.

    Writes DIR/strangers_SEED.csv. Exit code 1 if a run crashed.
    """
    rows: list[Row] = []
    for number in range(first, first + count):
        for row in tried(seed, number, pipelines, time_limit):
            why = f" ({row['reason']}: {row['words'][:200]})" if row["reason"] else ""
            seconds = row.get("seconds", "-")
            click.echo(f"{row['scene']} x {row['pipeline']}: {row['verdict']}{why}, {seconds} s")
            rows.append(row)
    click.echo(summary(rows))
    make_folder(out)
    path = out / f"strangers_{seed}.csv"
    write_durably(path, as_csv(rows))
    click.echo(str(path))
    return 1 if any(row["reason"] == CRASH for row in rows) else 0
