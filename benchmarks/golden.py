"""The golden campaign: what a full campaign found, without its seconds, as small committed data.

And what a change of the code moved.

    python -m validate all --out runs/golden; python -m benchmarks golden compare runs/golden
    --exit-code $? python -m benchmarks golden freeze runs/golden --exit-code 0 # writes
    benchmarks/golden.csv python -m benchmarks golden table # of it, the table of docs/results.md

A row is a stage of a run, or a check (stress case, FMU check): outcome, verdict, iterations, the
certificate's letter, the hash of the FMU, the main figures to nine digits, and `bits`, a hash of
every number of the record at full precision. Two rows of equal bits are equal; of the others the
figures say by how much they differ.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click

from benchmarks.options import campaign_argument
from formulations.pipelines import PIPELINES
from reports.paper import SCENE
from reports.records.check_record import CheckRecord
from reports.records.load import load
from reports.records.record import HOLD, RunRecord, StageRecord
from reports.rule import failures
from validate.tasks.paper import table_rows

GOLDEN = Path(__file__).with_suffix(".csv")
KEY = ("scene", "pipeline", "part", "stage")
WORDS = ("method", "eps", "outcome", "verdict", "judged", "iterations", "letter", "fmu")
FIGURES = (
    "cost", "terminal_error", "replay_terminal_error", "discrete_terminal_error", "replay_error",
    "physics_scaled", "defect", "law_error", "unexplained_force",
    "max_penetration", "feedback_share",
)  # fmt: skip
COLUMNS = (*KEY, *WORDS, *FIGURES, "bits")
# Figures that differ by less, relative to the larger and beyond the floor, differ by rounding.
SAME = 1e-6
FLOOR = 1e-9
# From worst to best; other words are no steps of the ladder.
LADDER = ("no plan", "undecided", "violates", "holds with feedback", "holds")

Row = dict[str, str]


def bits(record: StageRecord | CheckRecord) -> str:
    """A hash of all that a record says but its seconds, how it fares in perturbed worlds, where it was made, and which of two equal stages ran first."""
    left_out = {
        "shared_from": True, "seconds": True, "survey": True, "starts": {"__all__": {"seconds"}},
        "replay": {"seconds_reference", "seconds_everyday"},
        "wall_seconds": True, "cpu_seconds": True, "provenance": True, "log_tail": True,
        "key": True,
        "fmu": {"export_seconds": True, "check_seconds": True, "rows": {"__all__": {"seconds"}}},
    }  # fmt: skip
    known = {name: what for name, what in left_out.items() if name in type(record).model_fields}
    told = record.model_dump(mode="json", exclude=known)
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


def rows(folder: Path) -> Iterator[Row]:
    """One row for each stage and check of a campaign, in the order of their names."""
    stored = load(folder)
    if stored.unreadable or stored.missing:
        raise click.UsageError(
            f"{folder}: the campaign is not whole ({len(stored.unreadable)} unreadable and {len(stored.missing)} missing records); end it first."
        )
    runs = [part for parts in stored.parts for part in parts]
    for run in sorted(runs, key=lambda run: (run.scene.name, run.pipeline, run.part)):
        for stage in run.stages:
            yield _stage(run, stage)
        if not run.stages:
            yield _row(run, stage="0", outcome=run.outcome, verdict=run.verdict)
    for item in sorted(stored.checks, key=lambda item: (item.kind, item.name, item.scene or "")):
        digest = item.fmu.sha256[:16] if item.fmu is not None else ""
        verdict = "passed" if item.passed else "failed"
        words = dict.fromkeys(COLUMNS, "") | {
            "scene": item.scene or item.name,
            "pipeline": f"{item.kind}: {item.name}",
            "outcome": item.outcome,
        }
        yield words | {
            "part": "1",
            "stage": "0",
            "verdict": verdict,
            "fmu": digest,
            "bits": bits(item),
        }


def _row(run: RunRecord, **words: str) -> Row:
    return (
        dict.fromkeys(COLUMNS, "")
        | {"scene": run.scene.name, "pipeline": run.pipeline, "part": str(run.part)}
        | words
    )


def _stage(run: RunRecord, stage: StageRecord) -> Row:
    replay, certificate = stage.replay, stage.certificate
    figures = {
        name: metric.value for name in FIGURES if (metric := stage.metric(name)) is not None
    } | {"cost": stage.cost}
    return _row(
        run,
        stage=str(stage.index + 1),
        method=stage.method,
        eps="" if stage.eps is None else f"{stage.eps:g}",
        outcome=stage.outcome,
        verdict=stage.verdict,
        judged="" if replay is None else replay.judged,
        iterations=str(stage.iterations),
        letter="" if certificate is None else certificate.letter,
        fmu="" if replay is None else replay.fmu[:16],
        bits=bits(stage),
        **{name: f"{value:.9g}" for name, value in figures.items() if value is not None},
    )


def differences(before: Row, after: Row) -> dict[str, tuple[str, str]]:
    """Words that differ, and figures that differ by more than rounding: name -> before, after."""
    return {
        name: (before[name], after[name])
        for name in (*WORDS, *FIGURES)
        if before[name] != after[name] and not _rounded(name, before[name], after[name])
    }


def _rounded(name: str, before: str, after: str) -> bool:
    if name not in FIGURES or not before or not after:
        return False
    return abs(float(before) - float(after)) <= max(
        FLOOR, SAME * max(abs(float(before)), abs(float(after)))
    )


def worse(before: Row, after: Row) -> bool:
    """A worse verdict, a plan of the same verdict that costs more, or a check that fails now."""
    if before["verdict"] != after["verdict"]:
        if after["verdict"] == "failed":
            return True
        on_ladder = before["verdict"] in LADDER and after["verdict"] in LADDER
        return on_ladder and LADDER.index(after["verdict"]) < LADDER.index(before["verdict"])
    if after["verdict"] not in HOLD or not before["cost"] or not after["cost"]:
        return False
    return float(after["cost"]) > float(before["cost"]) and not _rounded(
        "cost", before["cost"], after["cost"]
    )


def frozen() -> tuple[list[Row], str]:
    """The committed rows, and the exit code of the campaign that they are of."""
    with GOLDEN.open(encoding="utf-8", newline="") as file:
        code = file.readline().removeprefix("# exit code ").strip()
        return list(csv.DictReader(file)), code


@click.group()
def command() -> None:
    """Freeze a campaign, or compare one with what is frozen."""


@command.command()
@campaign_argument
@click.option(
    "--exit-code", type=int, required=True, help="What the campaign's command ended with."
)
def freeze(folder: Path, exit_code: int) -> None:
    """Write the campaign's rows to benchmarks/golden.csv."""
    found = list(rows(folder))
    with GOLDEN.open("w", encoding="utf-8", newline="") as file:
        file.write(f"# exit code {exit_code}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([row[column] for column in COLUMNS] for row in found)
    click.echo(f"{len(found)} rows in {GOLDEN}")


@command.command()
@campaign_argument
@click.option(
    "--exit-code", type=int, help="What the campaign's command ended with, to be compared too."
)
@click.option("--bits", "strict", is_flag=True, help="Fail where any number differs at all.")
def compare(folder: Path, exit_code: int | None, strict: bool) -> int:
    """What the campaign in FOLDER found otherwise.

    Exit code 1 where something is worse or gone (--bits: where anything differs).
    """
    kept, code = frozen()
    before = {tuple(row[name] for name in KEY): row for row in kept}
    after = {tuple(row[name] for name in KEY): row for row in rows(folder)}
    told: Counter[str] = Counter()
    for key in sorted(before.keys() | after.keys()):
        where = " | ".join(key)
        if key not in after or key not in before:
            word = "gone" if key in before else "new"
            told[word] += 1
            click.echo(f"{word:7s} {where}")
        elif before[key]["bits"] != after[key]["bits"]:
            found = differences(before[key], after[key])
            word = "worse" if worse(before[key], after[key]) else "moved" if found else "rounded"
            told[word] += 1
            if found:
                click.echo(
                    f"{word:7s} {where}: "
                    + ", ".join(f"{name} {was} -> {now}" for name, (was, now) in found.items())
                )
        else:
            told["equal"] += 1
    if exit_code is not None and str(exit_code) != code:
        told["worse"] += 1
        click.echo(f"worse   the campaign ended with exit code {exit_code}, {code} before")
    for sentence in failures(load(folder).runs, load(folder).checks):
        click.echo(f"failure {sentence}")
    click.echo(", ".join(f"{count} {word}" for word, count in told.most_common()))
    return 1 if told["worse"] or told["gone"] or (strict and set(told) != {"equal"}) else 0


@command.command()
def table() -> None:
    """Print what is frozen of the paper's scene as the table of docs/results.md."""
    click.echo(results_table(), nl=False)


def results_table() -> str:
    """The stages of Table I, and how each of our pipelines ends, as a Markdown table.

    A stage that pipelines share once.
    """
    lines = [
        "| pipeline | stage | eps | cost | paper | error: plan | own grid | replay | verdict |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    kept = [
        row for row in frozen()[0] if (row["scene"], row["part"]) == (SCENE, "1") and row["cost"]
    ]
    seen: set[tuple[str, ...]] = set()
    for pipeline in PIPELINES:
        stages = [row for row in kept if row["pipeline"] == pipeline.name]
        paper = [f"{row.numbers['cost']:.2f}" for row in table_rows(pipeline.name)]
        for place, row in enumerate(stages):
            stage = tuple(row[name] for name in ("method", "eps", "cost"))
            if stage in seen or (not paper and row is not stages[-1]):
                continue
            seen.add(stage)
            errors = (
                f"{float(row[name]):.2g}" if float(row[name]) > FLOOR else "0"
                for name in ("terminal_error", "discrete_terminal_error", "replay_terminal_error")
            )
            costs = (f"{float(row['cost']):.2f}", paper[place] if paper else "")
            cells = (pipeline.name, row["method"], row["eps"], *costs, *errors, row["verdict"])
            lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(lines) + "\n"
