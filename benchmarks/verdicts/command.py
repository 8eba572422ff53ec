"""`verdicts`: see the package's docstring."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from benchmarks.options import COUNT, json_option, seed_option
from benchmarks.verdicts import exact, ladders, search, wrong
from benchmarks.verdicts.plans import (
    SKIPPED,
    Case,
    NoPlanError,
    Plan,
    Said,
    judged_in_time,
    scene_of,
)
from models.errors import TouchstoneError
from validate.processes.disk import write_durably

GROUPS = ("exact", "wrong", "ladders", "search")
SCENES = (
    "three_cart", "wall_pendulum", "cart_chain", "hopper", "two_discs", "transport",
    "two_discs_wall", "cart_pole_walls", "acrobot_limits", "hopper_planar",
)  # fmt: skip


def answer(case: Case, folder: Path) -> Said:
    """What the judge says of the case's plan, written as a CSV file into a folder.

    "skipped" where the plan cannot be made.
    """
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
                    "plan": case.name, "expected": list(case.expected), "causes": list(case.causes),
                    "said": said.verdict, "why": said.why, "differs": fault,
                    "seconds": round(time.perf_counter() - began, 2), "figures": dict(said.figures),
                }
            )  # fmt: skip
            click.echo(
                f"{'!! ' + fault if fault else 'ok':12}{case.name:75} {said.verdict:20} {said.why[:160]}"
            )
            if fault:
                click.echo(f"{'':12}expected: {expected}")
    return wrong_ones


@click.command()
@click.argument("groups", nargs=-1, type=click.Choice(GROUPS), metavar="[GROUP]...")
@click.option(
    "--scene",
    "scenes",
    type=click.Choice(SCENES),
    multiple=True,
    default=SCENES,
    help="Only these scenes; may be repeated.",
)
@click.option(
    "-k", "only", default="", metavar="TEXT", help="Only plans whose name has this in it."
)
@click.option(
    "--tries",
    type=COUNT,
    default=10,
    show_default=True,
    help="Wrong plans that the search makes for each scene.",
)
@seed_option
@click.option(
    "--finds", type=click.Path(path_type=Path), default="runs/verdict_finds", show_default=True,
    help="Where plans go that the search finds to cheat."
)  # fmt: skip
@json_option
def command(
    groups: tuple[str, ...], scenes: tuple[str, ...], only: str, tries: int, seed: int, finds: Path,
    file: Path | None
) -> int:  # fmt: skip
    """Plans whose verdict is known, tried on the judge: GROUP is exact, wrong, ladders or search (default: all); exit code 1 where one is another."""
    groups = groups or GROUPS
    table: dict[str, Any] = {}
    faults = 0
    made = {"exact": exact.cases, "wrong": wrong.cases}
    for group in (name for name in made if name in groups):
        table[group] = []
        faults += _told(made[group](scenes), only, table[group])
    if only and not any(table.values()) and not {"ladders", "search"} & {*groups}:
        raise click.UsageError(f"no plan of {', '.join(scenes)} has {only!r} in its name.")
    for name, rows in table.items():
        skipped = sum(row["said"] == SKIPPED for row in rows)
        odd = sum(bool(row["differs"]) for row in rows)
        click.echo(f"{name}: {len(rows)} plans, {skipped} skipped, {odd} not as expected")
    if "ladders" in groups:
        table["ladders"] = ladders.run(list(scenes))
        faults += table["ladders"]["not_monotone"]
    if "search" in groups:
        result = search.run(list(scenes), tries, seed, finds)
        faults += result["said_to_hold"] + result["not_answered"]
        table["search"] = result
    if file is not None:
        write_durably(file, json.dumps(table, indent=1) + "\n")
    return 1 if faults else 0
