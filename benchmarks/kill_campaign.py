"""A campaign killed with signal 9 at random moments and resumed, over and over: nothing finished is lost, nothing damaged, nothing left behind.

    python benchmarks/kill_campaign.py [--kills 25] [--seed 0] [--engine local|dask|standing] [--signal kill|int] [-j 2] [--out FILE.json]

The cells are those of tests/validate/campaign_fakes.py, which take little time, so that many moments are of the store. With `standing`, the workers of a
cluster that goes on end what a killed campaign had begun. `--signal int` is Ctrl-C: the campaign must also say how to go on, and count rightly. Prints
the figures as JSON; exit code 1 where a promise was broken, or nothing that finished was found again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "validate")]


def main() -> int:
    from killed_campaigns import environment, kill_and_resume
    from standing_cluster import standing_cluster

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", default="local", choices=["local", "dask", "standing"], help="standing: a cluster by its address")
    parser.add_argument("--signal", default="kill", choices=["kill", "int"], help="int: as Ctrl-C, which must also end in words")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    began, used = time.perf_counter(), os.times()
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as standing:
        folder, engine, cluster = Path(name), chosen.engine, None
        cache = folder / "cache"
        if engine == "standing":
            (folder / "cluster").mkdir()
            file, cluster = standing.enter_context(standing_cluster(folder / "cluster", environment(cache), chosen.jobs))
            engine = f"dask:{file}"
        number = signal.SIGKILL if chosen.signal == "kill" else signal.SIGINT
        seen = kill_and_resume(folder, cache, chosen.kills, chosen.seed, "--engine", engine, "-j", str(chosen.jobs), number=number)
        if cluster is not None and cluster.poll() is not None:
            seen.faults.append("the cluster that stands by itself did not live on")
    now = os.times()
    told = {
        "engine": chosen.engine,
        "signal": chosen.signal,
        "kills": seen.kills,
        "campaigns_brought_to_their_end": seen.campaigns,
        "finished_cells_found_again": seen.kept,
        "faults": seen.faults,
        "stored_and_seconds_later": [[stored, round(moment, 2)] for stored, moment in seen.moments],
        "cpu_s": round(now.children_user + now.children_system - used.children_user - used.children_system, 1),
        "wall_s": round(time.perf_counter() - began, 1),
    }
    print(json.dumps(told, indent=1))
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(told, indent=1), encoding="utf-8")
    return 1 if seen.faults or not seen.kept else 0


if __name__ == "__main__":
    sys.exit(main())
