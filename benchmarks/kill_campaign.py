"""A campaign killed with signal 9 at random moments and resumed, over and over: nothing finished is lost, nothing damaged, nothing left behind.

    python benchmarks/kill_campaign.py [--kills 25] [--seed 0] [--engine local|dask] [-j 2] [--out FILE.json]

The cells are those of tests/validate/campaign_fakes.py, which take little time, so that many moments are of the store. Prints the figures as JSON; exit code 1
where a promise was broken.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "validate")]


def main() -> int:
    from killed_campaigns import kill_and_resume

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", default="local")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen = kill_and_resume(
            Path(folder), Path(folder) / "cache", chosen.kills, chosen.seed, "--engine", chosen.engine, "-j", str(chosen.jobs)
        )
    told = {
        "kills": seen.kills,
        "campaigns_brought_to_their_end": seen.campaigns,
        "finished_cells_found_again": seen.kept,
        "faults": seen.faults,
        "moments_s": [round(moment, 2) for moment in seen.moments],
    }
    print(json.dumps(told, indent=1))
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(told, indent=1), encoding="utf-8")
    return 1 if seen.faults else 0


if __name__ == "__main__":
    sys.exit(main())
