"""`kills`: campaigns and what runs for them killed at random moments, and resumed: nothing finished is lost, nothing damaged, nothing left behind."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path

import click

from benchmarks import find_modules_in
from benchmarks.options import COUNT, json_option, seed_option
from validate.cli.table import print_table
from validate.processes.disk import write_durably

# Of each engine, who is killed with signal 9, and how often Ctrl-C comes; the supervisor of a task
# and what it was forked from run beside it.
_VICTIMS = {
    "local": ("campaign", "child", "supervisor", "preloaded"),
    "dask": ("campaign", "child", "supervisor", "preloaded", "worker"),
    "standing": ("campaign", "child", "supervisor", "preloaded", "worker", "scheduler"),
}
# Where Linux keeps shared memory and semaphores.
_SHARED = Path("/dev/shm")


@click.command()
@click.option("--count", type=COUNT, default=25, show_default=True, help="How many kills.")
@seed_option
@click.option(
    "--engine", "engines", type=click.Choice(list(_VICTIMS)), multiple=True,
    help="Only these; `standing` is a Dask cluster that stands by itself."
)  # fmt: skip
@click.option("-j", "--jobs", type=COUNT, default=2, show_default=True)
@json_option
def command(count: int, seed: int, engines: tuple[str, ...], jobs: int, file: Path | None) -> int:
    """Kill campaigns, and what runs for them, at random moments; resume them by any engine.

    A table; exit code 1 where a promise was broken.

    With signal 9: the campaign, a task's child, the child's supervisor, what that was forked from,
    the Dask worker, the scheduler of a cluster. Ctrl-C comes as a terminal sends it, and must also
    say how to go on, and count rightly. The tasks are those of
    tests/validate/fakes/campaign_fakes.py, which take little time, so that many moments are of the
    store. A campaign that was killed is resumed until it comes to its end undisturbed.
    """
    find_modules_in("tests/validate/fakes")
    from killed_campaigns import Fault, Kill, environment, kill_and_resume, see_gone  # pyright: ignore[reportMissingImports]
    from standing_cluster import standing_cluster  # pyright: ignore[reportMissingImports]

    every = [
        Kill(engine=name, victim=victim)
        for name in engines or _VICTIMS
        for victim in _VICTIMS[name]
    ]
    every += [Kill(engine=name, number=signal.SIGINT) for name in engines or _VICTIMS]
    draw, kills = random.Random(seed), []
    while len(kills) < count:
        kills += draw.sample(every, min(len(every), count - len(kills)))
    began, shared = time.perf_counter(), set(os.listdir(_SHARED))
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as standing:
        folder = Path(name)
        for part in ("cluster", "temporary"):
            (folder / part).mkdir()
        os.environ["TMPDIR"] = str(
            folder / "temporary"
        )  # of all campaigns: it must be empty after each
        cluster: list = []

        def where(engine: str) -> str:
            if engine != "standing":
                return engine
            if not cluster or cluster[-1][1].poll() is not None:
                place = folder / "cluster" / str(len(cluster))
                place.mkdir()
                about = {**environment(folder / "cache"), "TMPDIR": str(place)}
                cluster.append(standing.enter_context(standing_cluster(place, about, jobs)))
            return f"dask:{cluster[-1][0]}"

        seen = kill_and_resume(
            folder,
            folder / "cache",
            kills,
            seed,
            "-j",
            str(jobs),
            where=where,
            scheduler=lambda: cluster[-1][1].pid if cluster else 0,
        )
    see_gone(
        lambda: set(os.listdir(_SHARED)) - shared, seen, "shared memory"
    )  # a cluster that stands has some while it does
    print_table(
        ["engine", "killed", "signal", "kills", *(fault.value for fault in Fault)],
        [
            [
                kill.engine,
                kill.victim,
                kill.number.name,
                str(times),
                *(
                    str(
                        sum(
                            seen.kills[after - 1] == kill and found is fault
                            for after, found, _ in seen.faults
                        )
                    )
                    for fault in Fault
                ),
            ]
            for kill, times in sorted(Counter(seen.kills).items(), key=lambda item: str(item[0]))
        ],
    )
    click.echo(
        f"{len(seen.kills)} kills in {seen.campaigns} campaigns; {seen.kept} finished tasks were found again, {len(seen.faults)} faults"
    )
    for after, fault, what in seen.faults:
        click.echo(f"after kill {after} ({seen.kills[after - 1]}): {fault.value}: {what}", err=True)
    if file is not None:
        told = {
            "kills": [[kill.engine, kill.victim, kill.number.name] for kill in seen.kills],
            "campaigns_brought_to_their_end": seen.campaigns,
            "finished_tasks_found_again": seen.kept,
            "faults": [[after, fault.value, what] for after, fault, what in seen.faults],
            "stored_and_seconds_later": [
                [stored, round(moment, 2)] for stored, moment in seen.moments
            ],
            "wall_s": round(time.perf_counter() - began, 1),
        }
        write_durably(file, json.dumps(told, indent=1))
    return 1 if seen.faults or not seen.kept else 0
