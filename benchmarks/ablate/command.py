"""`ablate`: see the package's docstring."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.ablate.rules import RULES, Rule
from benchmarks.ablate.trial import CARTS, STRANGER
from benchmarks.options import POSITIVE, out_option, seed_option
from benchmarks.results import as_text
from models.catalog import scene_names
from validate.processes.disk import make_folder, write_durably
from validate.processes.isolated import Limits, run_isolated

Row = dict[str, Any]

COLUMNS: tuple[str, ...] = (
    "rule",
    "case",
    "pipeline",
    "outcome",
    "verdict",
    "cost",
    "cpu",
    "was",
    "cost_was",
    "cpu_was",
)
# Verdicts, the best first.
_ORDER = ("holds", "holds with feedback", "consistent", "undecided", "violates", "no plan")
# Part of a cost by which it counts as higher.
_HIGHER = 0.01
# Seconds of a child beside its pipeline: compilers, the replay.
_BESIDE = 240.0
_MEMORY = 64 * 1024**3  # PyTorch maps a lot that it never uses


def tried(rule: str, case: str, pipeline: str, time_limit: float) -> Row:
    """Return the row of one run. rule: empty for none switched off."""
    request = {"rule": rule, "case": case, "pipeline": pipeline, "time_limit": time_limit}
    limits = Limits(seconds=_BESIDE + time_limit, memory=_MEMORY)
    what = f"{case} x {pipeline} without {rule or 'nothing'}"
    done = run_isolated(
        "benchmarks.ablate.trial:attempt", request, limits=limits, what=what, ours=True
    )
    found = done.value if done.ok else {"outcome": "crash", "verdict": "no plan", "cost": None}
    return {
        "cpu": math.nan,
        "acting": [],
        **found,
        "rule": rule,
        "case": case,
        "pipeline": pipeline,
    }


def compared(
    rules: Sequence[Rule], cases: Sequence[str], time_limit: float
) -> Iterator[tuple[Row, Row]]:
    """Yield each run with a rule switched off, and the same with none."""
    for pipeline in dict.fromkeys(name for rule in rules for name in rule.pipelines):
        for case in cases:
            before = tried("", case, pipeline, time_limit)
            if "refused" in before:
                continue
            for rule in rules:
                if pipeline in rule.pipelines and rule.name in before["acting"]:
                    yield tried(rule.name, case, pipeline, time_limit), before


def is_worse(row: Row, before: Row) -> bool:
    """Return whether a verdict is worse than with the rule."""
    return _ORDER.index(row["verdict"]) > _ORDER.index(before["verdict"])


def cost_ratio(row: Row, before: Row) -> float:
    """Return the cost without the rule over the one with it; 1 where either has no plan."""
    if row["cost"] is None or not before["cost"] or row["verdict"] != before["verdict"]:
        return 1.0
    return float(row["cost"] / before["cost"])


def summary(pairs: Sequence[tuple[Row, Row]]) -> str:
    """Return a table with a line for each rule."""
    table = []
    for name in dict.fromkeys(row["rule"] for row, _ in pairs):
        of = [pair for pair in pairs if pair[0]["rule"] == name]
        ratios = [cost_ratio(*pair) for pair in of]
        cpu = sum(row["cpu"] for row, _ in of) / sum(before["cpu"] for _, before in of)
        table.append(
            (
                name,
                len(of),
                sum(is_worse(*pair) for pair in of),
                sum(is_worse(before, row) for row, before in of),
                sum(ratio > 1.0 + _HIGHER for ratio in ratios),
                sum(ratio < 1.0 - _HIGHER for ratio in ratios),
                round(max(ratios), 3),
                round(cpu, 2),
            )
        )
    columns = (
        "without", "runs", "worse", "better", "dearer", "cheaper", "largest cost ratio", "CPU ratio"
    )  # fmt: skip
    return as_text(columns, table)


def as_csv(pairs: Sequence[tuple[Row, Row]]) -> str:
    """Return the runs as CSV."""
    file = io.StringIO()
    writer = csv.DictWriter(file, COLUMNS, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for row, before in pairs:
        was = {f"{name}_was": before[name] for name in ("cost", "cpu")}
        writer.writerow({**row, "was": before["verdict"], **was})
    return file.getvalue()


@click.command()
@click.option(
    "--rule", "words", multiple=True, metavar="TEXT", help="Rules whose names contain it."
)
@click.option(
    "--scene", "scenes", multiple=True, metavar="NAME", help="Only these scenes of the bank."
)
@click.option(
    "--carts", type=click.IntRange(min=0), default=8, show_default=True, help="Rows of carts."
)
@click.option(
    "--strangers", type=click.IntRange(min=0), default=8, show_default=True, help="Drawn scenes."
)
@seed_option
@click.option("--time-limit", type=POSITIVE, default=60.0, show_default=True, metavar="SECONDS")
@out_option
def command(
    words: tuple[str, ...],
    scenes: tuple[str, ...],
    carts: int,
    strangers: int,
    seed: int,
    time_limit: float,
    out: Path,
) -> int:
    """Planners without one of their rules: which verdicts and costs get worse.

    A rule is tried where it acts: on the scenes of the bank, rows of carts and drawn scenes.
    Writes DIR/ablate.csv.
    """
    rules = [rule for rule in RULES if not words or any(word in rule.name for word in words)]
    if not rules:
        names = "; ".join(rule.name for rule in RULES)
        raise click.BadParameter(f"no rule contains {' or '.join(words)}. Rules: {names}.")
    cases = [
        *(scenes or scene_names()),
        *(f"{CARTS} {number}" for number in range(carts)),
        *(f"{STRANGER} {seed} {number}" for number in range(strangers)),
    ]
    pairs = []
    make_folder(out)
    for row, before in compared(rules, cases, time_limit):
        pairs.append((row, before))
        moved = f"{before['verdict']} {before['cost']} -> {row['verdict']} {row['cost']}"
        click.echo(f"{row['case']} x {row['pipeline']} without {row['rule']}: {moved}")
        write_durably(out / "ablate.csv", as_csv(pairs))
    click.echo(summary(pairs))
    return 0
