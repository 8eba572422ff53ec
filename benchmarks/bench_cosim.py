"""What it costs to split a scene into FMUs, contacts in FMUs of their own: energy, momentum and CPU time against the macro step.

    python benchmarks/bench_cosim.py [-o FILE.json] [--step H ...]

Masters: Jacobi, contact first (Gauss-Seidel), force extrapolated, iterated with rollback - all ours -, libcosim with fixed steps and with ECCO
(where `[fmu-check]` is installed), and the whole scene as one FMU. A report takes the file from DIR/bench/: see docs/cosimulation.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from validate.cosim.study import MACRO_STEPS, cases, study


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, help="write all numbers as JSON")
    parser.add_argument("--step", type=float, nargs="+", default=MACRO_STEPS, help="macro steps [s] that divide 0.01 s")
    arguments = parser.parse_args()
    told = [study(case, arguments.step, lambda line: print(line, file=sys.stderr)) for case in cases()]
    for case in told:
        print(f"{case['title']}: omega = {case['frequency']:.4g} rad/s")
        print(f"  {'':16}" + "".join(f"{h:>12g}" for h in arguments.step))
        for master in case["masters"]:
            errors = "".join(f"{row['energy_error']:>+12.2e}" for row in master["rows"])
            print(f"  {master['name']:16}{errors} {master['failed']}")
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps({"kind": "cosim", "cases": told}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
