"""Hostile files for all readers, counted: plans, maps, campaigns, scene files, FMUs, NetCDF, records.

    python benchmarks/fuzz_readers.py [--each 1500] [--first 0] [--only "FMU"] [--out FILE.json]

Each reader runs in processes of its own, some hundred files in each, so that one that dies is counted too. Prints a line a reader; exit code 1 where any
file ended in a traceback, a hang or a crash, with the seeds that make it again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "validate")]
CHUNK = 250
MEMORY = 6 * 1024**3  # [bytes] of address space: a reader that takes more has been made to


def _chunk(name: str, seeds: range, results: str) -> None:
    from hostile_inputs import READERS, tried

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as folder, open(results, "a", encoding="utf-8") as file:
        for seed in seeds:
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
            process = multiprocessing.get_context("spawn").Process(target=_chunk, args=(name, part, str(results)))
            process.start()
            process.join()
            lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
            found |= dict(map(json.loads, lines))
            dead = next((seed for seed in part if seed not in found), None)
            if dead is not None:
                found[dead] = f"crash: the process ended with {process.exitcode}"
            left = [seed for seed in left if seed not in found]
    return found


def main() -> int:
    from hostile_inputs import READERS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=1500, help="hostile files for each reader (default 1500)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default 0)")
    parser.add_argument("--only", choices=list(READERS), help="only this reader")
    parser.add_argument("--out", type=Path, help="write the counts as JSON")
    asked = parser.parse_args()
    table, faults = {}, 0
    for name in [asked.only] if asked.only else list(READERS):
        began = time.perf_counter()
        found = fuzz(name, range(asked.first, asked.first + asked.each))
        counts = Counter(
            outcome if outcome in ("read", "refused", "hang") else outcome.split(":")[0][:20].strip() for outcome in found.values()
        )
        bad = {seed: outcome for seed, outcome in found.items() if outcome not in ("read", "refused")}
        faults += len(bad)
        table[name] = {"inputs": len(found), "faults": len(bad), **counts}
        told = ", ".join(f"{count} {what}" for what, count in counts.most_common())
        print(f"{name}: {len(found)} inputs, {told}; {len(bad)} faults; {time.perf_counter() - began:.0f} s", flush=True)
        for kind, seed in {outcome.strip().splitlines()[-1][:200]: seed for seed, outcome in bad.items()}.items():
            print(f"  seed {seed}: {kind}", flush=True)
    total = sum(row["inputs"] for row in table.values())
    print(f"{total} inputs, {faults} faults")
    if asked.out:
        asked.out.write_text(json.dumps(table, indent=1), encoding="utf-8")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
