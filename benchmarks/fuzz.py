"""`fuzz`: many of what the tests try a few of - random MPECs against all their branches, and hostile files for every reader."""

from __future__ import annotations

import json
import logging
import random
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import click

from benchmarks import find_modules_in
from benchmarks.measure import run_child
from benchmarks.options import COUNT, SEED, json_option
from validate.store.disk import write_durably

CHUNK = 250
MEMORY = 6 * 1024**3  # [bytes] of address space: a reader that takes more has been made to


@click.group("fuzz")
def command() -> None:
    """Random MPECs, and hostile files: counted, with exit code 1 where anything was wrong."""


@command.command("mpec")
@click.option("--seeds", type=COUNT, default=500, show_default=True, help="How many problems.")
@click.option("--first", type=SEED, default=0, show_default=True, help="The first seed.")
@json_option
def mpec(seeds: int, first: int, file: Path | None) -> int:
    """What `solve_mpec` says of random small MPECs beside what enumeration finds.

    Prints the agreement classes by kind of problem, and every problem that is not `same`. Exit code
    1 where an `optimal`, an `infeasible` or an `unbounded` was wrong. `worse` is another local
    solution: nonlinear programs are solved locally, here and in the enumeration.
    """
    from benchmarks.mpec import enumeration, generator

    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    classes: Counter[tuple[str, str]] = Counter()
    lines = []
    for seed in range(first, first + seeds):
        verdict = enumeration.judge(generator.random_mpec(seed))
        classes[verdict.agreement, verdict.kind] += 1
        lines.append(json.dumps(asdict(verdict)))
        if verdict.agreement != "same":
            click.echo(
                f"seed {seed} ({verdict.kind}): {verdict.outcome} {verdict.objective:.8g}, {verdict.agreement}; best {verdict.best:.8g} {verdict.note}"
            )
    kinds = sorted({kind for _, kind in classes})
    click.echo(
        "| agreement | all | " + " | ".join(kinds) + " |\n|---|" + "---:|" * (len(kinds) + 1)
    )
    for agreement in sorted({agreement for agreement, _ in classes}):
        counts = [classes[agreement, kind] for kind in kinds]
        click.echo(f"| {agreement} | {sum(counts)} | " + " | ".join(map(str, counts)) + " |")
    click.echo(f"{seeds} problems, {time.process_time():.0f} CPU s")
    if file is not None:
        write_durably(file, "\n".join(lines) + "\n")
    return 1 if any(agreement in enumeration.WRONG for agreement, _ in classes) else 0


def _chunk(name: str, results: str, *seeds: str) -> None:
    find_modules_in("tests/validate/fakes")
    from hostile_inputs import READERS, tried  # pyright: ignore[reportMissingImports]

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as folder, open(results, "a", encoding="utf-8") as file:
        for seed in map(int, seeds):
            outcome = tried(READERS[name], random.Random(seed), Path(folder))
            file.write(json.dumps([seed, outcome]) + "\n")
            file.flush()


def fuzz(name: str, seeds: range) -> dict[int, str]:
    """What came of each seed; one whose process died is a crash."""
    found: dict[int, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results.jsonl"
        left = list(seeds)
        while left:
            part = left[:CHUNK]
            done = run_child("benchmarks.fuzz", name, str(results), *map(str, part))
            lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
            found |= dict(map(json.loads, lines))
            dead = next((seed for seed in part if seed not in found), None)
            if dead is not None:
                found[dead] = f"crash: the process ended with {done.returncode}"
            left = [seed for seed in left if seed not in found]
    return found


@command.command("readers")
@click.option(
    "--each", type=COUNT, default=1500, show_default=True, help="Hostile files for each reader."
)
@click.option("--first", type=SEED, default=0, show_default=True, help="The first seed.")
@click.option("--only", metavar="READER", help="Only this reader.")
@json_option
def readers(each: int, first: int, only: str | None, file: Path | None) -> int:
    """Hostile plans, maps, campaigns, scene files, FMUs, NetCDF and records.

    Each reader runs in processes of its own, some hundred files in each, so that one that dies is
    counted too. Exit code 1 where any file ended in a traceback, a hang or a crash, with the seeds
    that make it again.
    """
    find_modules_in("tests/validate/fakes")
    from hostile_inputs import READERS  # pyright: ignore[reportMissingImports]

    if only is not None and only not in READERS:
        raise click.UsageError(f"there is no reader {only!r}; there are {', '.join(READERS)}.")
    table, faults = {}, 0
    for name in READERS if only is None else [only]:
        began = time.perf_counter()
        found = fuzz(name, range(first, first + each))
        counts = Counter(
            outcome
            if outcome in ("read", "refused", "hang")
            else outcome.split(":")[0][:20].strip()
            for outcome in found.values()
        )
        bad = {
            seed: outcome for seed, outcome in found.items() if outcome not in ("read", "refused")
        }
        faults += len(bad)
        table[name] = {"inputs": len(found), "faults": len(bad), **counts}
        told = ", ".join(f"{count} {what}" for what, count in counts.most_common())
        click.echo(
            f"{name}: {len(found)} inputs, {told}; {len(bad)} faults; {time.perf_counter() - began:.0f} s"
        )
        for kind, seed in {
            outcome.strip().splitlines()[-1][:200]: seed for seed, outcome in bad.items()
        }.items():
            click.echo(f"  seed {seed}: {kind}")
    click.echo(f"{sum(row['inputs'] for row in table.values())} inputs, {faults} faults")
    if file is not None:
        write_durably(file, json.dumps(table, indent=1))
    return 1 if faults else 0


if __name__ == "__main__":
    _chunk(*sys.argv[1:])
