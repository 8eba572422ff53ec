"""`kill`: a campaign killed at random moments and resumed, over and over: nothing finished is lost, nothing damaged, nothing left behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
import time
from pathlib import Path

import click

from benchmarks import find_modules_in
from benchmarks.options import COUNT, json_option, seed_option
from validate.store.disk import write_durably


@click.command()
@click.option("--kills", type=COUNT, default=25, show_default=True)
@seed_option
@click.option(
    "--engine",
    type=click.Choice(["local", "dask", "standing"]),
    default="local",
    show_default=True,
    help="standing: a cluster by its address.",
)
@click.option(
    "--signal",
    "word",
    type=click.Choice(["kill", "int"]),
    default="kill",
    show_default=True,
    help="int: as Ctrl-C, which must also end in words.",
)
@click.option("-j", "--jobs", type=COUNT, default=2, show_default=True)
@json_option
def command(kills: int, seed: int, engine: str, word: str, jobs: int, file: Path | None) -> int:
    """Kill a campaign with signal 9 at random moments and resume it; the figures as JSON, exit code 1 where a promise was broken.

    The cells are those of tests/validate/fakes/campaign_fakes.py, which take little time, so that many moments are of the store. With `standing`, the
    workers of a cluster that goes on end what a killed campaign had begun. Ctrl-C must also say how to go on, and count rightly.
    """
    find_modules_in("tests/validate/fakes")
    from killed_campaigns import environment, kill_and_resume  # pyright: ignore[reportMissingImports]
    from standing_cluster import standing_cluster  # pyright: ignore[reportMissingImports]

    began, used = time.perf_counter(), os.times()
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as standing:
        folder, where, cluster = Path(name), engine, None
        cache = folder / "cache"
        if engine == "standing":
            (folder / "cluster").mkdir()
            address, cluster = standing.enter_context(standing_cluster(folder / "cluster", environment(cache), jobs))
            where = f"dask:{address}"
        number = signal.SIGKILL if word == "kill" else signal.SIGINT
        seen = kill_and_resume(folder, cache, kills, seed, "--engine", where, "-j", str(jobs), number=number)
        if cluster is not None and cluster.poll() is not None:
            seen.faults.append("the cluster that stands by itself did not live on")
    now = os.times()
    told = {
        "engine": engine,
        "signal": word,
        "kills": seen.kills,
        "campaigns_brought_to_their_end": seen.campaigns,
        "finished_cells_found_again": seen.kept,
        "faults": seen.faults,
        "stored_and_seconds_later": [[stored, round(moment, 2)] for stored, moment in seen.moments],
        "cpu_s": round(now.children_user + now.children_system - used.children_user - used.children_system, 1),
        "wall_s": round(time.perf_counter() - began, 1),
    }
    click.echo(json.dumps(told, indent=1))
    if file is not None:
        write_durably(file, json.dumps(told, indent=1))
    return 1 if seen.faults or not seen.kept else 0
