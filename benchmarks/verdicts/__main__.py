"""`python -m benchmarks.verdicts`: see the package's docstring."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.verdicts import exact, search, wrong
from benchmarks.verdicts.plans import SKIPPED, Case, NoPlanError, Plan, Said, judged_in_time, scene_of
from models.errors import TouchstoneError

GROUPS = ("exact", "wrong", "search")
SCENES = (
    "three_cart", "wall_pendulum", "cart_chain", "hopper", "two_discs", "transport", "two_discs_wall", "cart_pole_walls", "acrobot_limits", "hopper_planar",
    "slider",
)  # fmt: skip


def answer(case: Case, folder: Path) -> Said:
    """What the judge says of the case's plan, written as a CSV file into a folder; "skipped" where the plan cannot be made."""
    try:
        scene = scene_of(case.scene)
        plan = case.plan if isinstance(case.plan, Plan) else case.plan()
    except (NoPlanError, TouchstoneError) as error:
        return Said(verdict=SKIPPED, why=str(error))
    return judged_in_time(scene, plan.write(folder / "plan.csv", scene))


def differs(case: Case, said: Said) -> str:
    """What is not as expected, or nothing."""
    if said.verdict == SKIPPED:
        return ""
    if said.verdict not in case.expected:
        return "verdict"
    lowered = said.why.lower()
    named = not case.causes or any(cause in lowered for cause in case.causes)
    return "" if named and not any(cause in lowered for cause in case.never) else "cause"


def _told(cases: Iterator[Case], only: str, rows: list[dict[str, object]]) -> int:
    wrong_ones = 0
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            if only not in case.name:
                continue
            began = time.perf_counter()
            said = answer(case, Path(folder))
            fault = differs(case, said)
            wrong_ones += bool(fault)
            expected = case.expected[0] + (f" ({'|'.join(case.causes)})" if case.causes else "")
            expected += f", never {'|'.join(case.never)}" if case.never else ""
            rows.append(
                {
                    "plan": case.name, "expected": list(case.expected), "causes": list(case.causes), "said": said.verdict, "why": said.why, "differs": fault,
                    "seconds": round(time.perf_counter() - began, 2), "figures": dict(said.figures),
                }
            )  # fmt: skip
            print(f"{'!! ' + fault if fault else 'ok':12}{case.name:75} {said.verdict:20} {said.why[:160]}", flush=True)
            if fault:
                print(f"{'':12}expected: {expected}", flush=True)
    return wrong_ones


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verdicts", description="Plans whose verdict is known, tried on the judge.")
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)} (default: all)")
    parser.add_argument("--scene", action="append", choices=SCENES, help="only these scenes (repeat)")
    parser.add_argument("-k", dest="only", default="", help="only plans whose name has this in it")
    parser.add_argument("--tries", type=int, default=10, help="wrong plans that the search makes for each scene (default 10)")
    parser.add_argument("--seed", type=int, default=0, help="of the search (default 0)")
    parser.add_argument(
        "--finds", type=Path, default=Path("runs/verdict_finds"), help="folder for plans that the search finds to cheat the judge"
    )
    parser.add_argument("--mujoco", default=sys.executable, help="a Python that has MuJoCo (default: this one)")
    parser.add_argument("--drake", default=sys.executable, help="a Python that has Drake (default: this one)")
    parser.add_argument("-o", "--out", type=Path, help="write what was said as JSON")
    asked = parser.parse_args()
    groups = asked.groups or list(GROUPS)
    if not set(groups) <= set(GROUPS):
        parser.error(f"there are the groups {', '.join(GROUPS)}, not {', '.join(set(groups) - set(GROUPS))}")
    scenes = tuple(asked.scene or SCENES)
    table: dict[str, Any] = {}
    faults = 0
    with tempfile.TemporaryDirectory() as folder:
        if "exact" in groups:
            rows: list[dict[str, object]] = []
            faults += _told(exact.cases(scenes, {"mujoco": asked.mujoco, "drake": asked.drake}), asked.only, rows)
            table["exact"] = rows
        if "wrong" in groups:
            rows = []
            faults += _told(wrong.cases(scenes, Path(folder)), asked.only, rows)
            table["wrong"] = rows
    for name, rows in table.items():
        skipped = sum(row["said"] == SKIPPED for row in rows)
        odd = sum(bool(row["differs"]) for row in rows)
        print(f"{name}: {len(rows)} plans, {skipped} skipped, {odd} not as expected")
    if "search" in groups:
        result = search.run([name for name in scenes if name != "slider"], asked.tries, asked.seed, asked.finds)
        faults += result["said_to_hold"] + result["not_answered"]
        table["search"] = result
    if asked.out:
        asked.out.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
