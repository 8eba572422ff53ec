"""Random small MPECs against all their branches: what `solve_mpec` says beside what enumeration finds, counted.

    python benchmarks/fuzz_mpec.py [--seeds 500] [--first 0] [--out FILE.jsonl]

Prints the agreement classes by kind of problem, and every problem that is not 'same'. Exit code 1 where an 'optimal', an 'infeasible' or an
'unbounded' was wrong. 'worse' is another local solution: nonlinear programs are solved locally, here and in the enumeration.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import logging
import sys
import time
import warnings
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

FUZZ = Path(__file__).parents[1] / "tests" / "formulations" / "mpec" / "fuzz"


def enumeration() -> Any:
    """The module of the tests that holds the judge."""
    spec = importlib.util.spec_from_file_location("mpec_fuzz_enumeration", FUZZ / "enumeration.py")
    if spec is None or spec.loader is None:
        raise ImportError(str(FUZZ))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=500, help="how many problems (default 500)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default 0)")
    parser.add_argument("--out", type=Path, help="write every verdict as a line of JSON")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    judge = enumeration()
    classes: Counter[tuple[str, str]] = Counter()
    lines = []
    for seed in range(asked.first, asked.first + asked.seeds):
        verdict = judge.judge(judge.generator.random_mpec(seed))
        classes[verdict.agreement, verdict.kind] += 1
        lines.append(json.dumps(asdict(verdict)))
        if asked.out:
            asked.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
        if verdict.agreement != "same":
            print(
                f"seed {seed} ({verdict.kind}): {verdict.outcome} {verdict.objective:.8g}, {verdict.agreement}; best {verdict.best:.8g} {verdict.note}"
            )
            sys.stdout.flush()
    kinds = sorted({kind for _, kind in classes})
    print("| agreement | all | " + " | ".join(kinds) + " |\n|---|" + "---:|" * (len(kinds) + 1))
    for agreement in sorted({agreement for agreement, _ in classes}):
        counts = [classes[agreement, kind] for kind in kinds]
        print(f"| {agreement} | {sum(counts)} | " + " | ".join(map(str, counts)) + " |")
    print(f"{asked.seeds} problems, {time.process_time():.0f} CPU s")
    return 1 if any(agreement in judge.WRONG for agreement, _ in classes) else 0


if __name__ == "__main__":
    sys.exit(main())
