"""`replay --engine`: verdicts of other simulators on the plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from validate.cli.additions import Addition
from validate.cli.table import print_table, say, short
from validate.judge.engines.simulator import named_engines
from validate.processes.process import usable_cores

if TYPE_CHECKING:
    from validate.judge.judgement import Judgement
    from validate.processes.isolated import Limits


def _prepare(names: str, is_fmu: bool) -> tuple[str, ...]:
    if is_fmu:
        raise click.UsageError(
            "--engine belongs to --scene: another simulator cannot step an external FMU."
        )
    return named_engines(names)


def _results(
    judgement: Judgement, engines: tuple[str, ...], limits: Limits
) -> list[dict[str, Any]]:
    from validate.judge.engines.elsewhere import elsewhere

    rows = elsewhere(
        judgement,
        engines,
        limits=limits,
        jobs=usable_cores(),
        tell=lambda text: say(text, err=True),
    )
    return [row.as_json() for row in rows]


def _show(rows: Sequence[dict[str, Any]]) -> None:
    """Print the verdict of each engine, and the number of verdicts equal to ours."""
    same = {None: "", True: "yes", False: "no"}
    numbers = ("step or tolerance", "distance")
    cells = [
        [
            row["engine"],
            row["verdict"],
            same[row["agrees"]],
            short(row["step"]),
            short(row["distance"]),
            row["why"],
        ]
        for row in rows
    ]
    print_table(["engine", "verdict", "as ours", *numbers, "why"], cells, numbers)
    compared = [row for row in rows if row["agrees"] is not None]
    equal = sum(bool(row["agrees"]) for row in compared)
    say(f"The same in {equal} of {len(compared)} engines that step this scene.")


ADDITION = Addition(
    name="engines",
    option=click.option(
        "--engine",
        "engines",
        metavar="NAME,..|all",
        help="Verdicts of other simulators on the plan (docs/engines.md); all: the installed ones.",
    ),
    example="plan.csv --scene three_cart --engine all",
    prepare=_prepare,
    results=_results,
    show=_show,
)
