"""The golden campaign: results of full campaigns of one commit, frozen with their spread.

    python -m validate all --out runs/one; python -m validate all --out runs/two
    python -m benchmarks golden freeze runs/one runs/two      # writes benchmarks/golden.csv
    python -m benchmarks golden compare runs/all              # what is worse than every frozen run
    python -m benchmarks golden equal runs/one runs/two       # bit for bit: after moves and renames

A row is one stage of a run, or one check (stress case, FMU check). A cell holds the value of each
frozen campaign, separated by `|`; values that are equal up to rounding are written once.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.options import campaign_argument
from formulations.pipelines import PIPELINES, pipeline_names
from models.results.check import CheckRecord
from models.results.run import RunRecord, StageRecord
from models.results.stored import to_data
from models.results.verdict import HOLD
from reports.load import load
from reports.paper import SCENE
from reports.rule import failures
from validate.tasks.paper import table_rows

GOLDEN = Path(__file__).with_suffix(".csv")
KEY = ("scene", "pipeline", "stage")
WORDS = ("outcome", "verdict", "iterations")
FIGURES = (
    "cost",
    "terminal_error",
    "discrete_terminal_error",
    "replay_terminal_error",
    "replay_error",
    "physics_scaled",
    "answer_error",
)
COLUMNS: tuple[str, ...] = (*KEY, *WORDS, *FIGURES)
SEPARATOR = "|"
# Verdicts from worst to best. Other words ("not applicable", "consistent") have no order.
LADDER = ("no plan", "violates", "undecided", "holds with feedback", "holds")
# Largest increase of the cost of a solved exact stage beyond the spread, as a fraction of the cost.
COST_INCREASE = 0.01
# Two costs print the same two decimals, as the paper's Table I does, if they differ by less.
PRINTED = 0.01
# Figures below this are zero up to rounding.
FLOOR = 1e-9
# Figures that differ by less, relative to the larger, are equal up to rounding.
ROUNDING = 1e-6

Row = dict[str, str]


def rows(folder: Path) -> Iterator[Row]:
    """Yield one row per stage and per check of a campaign, ordered by name."""
    stored = load(folder)
    if stored.unreadable or stored.missing:
        raise click.UsageError(
            f"{folder}: the campaign is incomplete ({len(stored.unreadable)} unreadable and "
            f"{len(stored.missing)} missing records). Run the same command again to finish it."
        )
    for run in sorted(stored.runs, key=lambda run: (run.scene.name, run.pipeline)):
        yield from _stages(run)
    for check in sorted(stored.checks, key=lambda item: (item.kind, item.name, item.scene or "")):
        yield _row(
            scene=check.scene or check.name,
            pipeline=f"{check.kind}: {check.name}",
            stage="check",
            outcome=check.outcome,
            verdict="passed" if check.passed else "failed",
        )


def _row(**cells: str) -> Row:
    return dict.fromkeys(COLUMNS, "") | cells


def _stages(run: RunRecord) -> Iterator[Row]:
    names: Counter[str] = Counter()
    for stage in run.stages:
        name = stage.method if stage.eps is None else f"{stage.method} {stage.eps:g}"
        names[name] += 1
        if names[name] > 1:
            name = f"{name} #{names[name]}"
        metrics = {item: stage.metric(item) for item in FIGURES}
        figures = {item: metric.value for item, metric in metrics.items() if metric is not None}
        figures["cost"] = stage.cost
        yield _row(
            scene=run.scene.name,
            pipeline=run.pipeline,
            stage=name,
            outcome=stage.outcome,
            verdict=stage.verdict,
            iterations=str(stage.iterations),
            **{item: f"{value:.8g}" for item, value in figures.items() if value is not None},
        )
    if not run.stages:
        yield _row(
            scene=run.scene.name,
            pipeline=run.pipeline,
            stage="none",
            outcome=run.outcome,
            verdict=run.verdict,
        )


def key_of(row: Row) -> tuple[str, ...]:
    """Return the values of the columns that identify a row."""
    return tuple(row[name] for name in KEY)


def merged(campaigns: Sequence[Iterable[Row]]) -> list[Row]:
    """Return one row per key, with the values of all campaigns in each cell."""
    cells: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for campaign in campaigns:
        for row in campaign:
            columns = cells.setdefault(key_of(row), {name: [] for name in (*WORDS, *FIGURES)})
            for name, values in columns.items():
                for value in row[name].split(SEPARATOR):
                    if not any(_is_equal(name, value, kept) for kept in values):
                        values.append(value)
    return [
        dict(zip(KEY, key, strict=True))
        | {name: SEPARATOR.join(values) for name, values in columns.items()}
        for key, columns in cells.items()
    ]


def _is_equal(name: str, first: str, second: str) -> bool:
    if name not in FIGURES or not first or not second:
        return first == second
    a, b = float(first), float(second)
    return abs(a - b) <= max(FLOOR, ROUNDING * max(abs(a), abs(b)))


def frozen() -> list[Row]:
    """Return the committed rows."""
    with GOLDEN.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(found: Iterable[Row]) -> None:
    """Write rows to benchmarks/golden.csv."""
    with GOLDEN.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(found)


def _numbers(row: Row, name: str) -> list[float]:
    return [float(value) for value in row[name].split(SEPARATOR) if value]


def _paper_costs() -> dict[tuple[str, ...], float]:
    """Return the paper's cost for each (scene, pipeline, stage) of Table I."""
    return {
        (SCENE, pipeline.name, " ".join((row.methods[-1], *_eps(row.eps)))): row.numbers["cost"]
        for pipeline in PIPELINES
        for row in table_rows(pipeline.name)
    }


def _eps(eps: float | None) -> tuple[str, ...]:
    return () if eps is None else (f"{eps:g}",)


def verdict_faults(before: Row, after: Row) -> list[str]:
    """Return a phrase if the verdict of a run is worse than in every frozen campaign.

    before, after: rows of the last stages. A better verdict is no fault.
    """
    verdicts, verdict = before["verdict"].split(SEPARATOR), after["verdict"]
    if verdict in verdicts:
        return []
    ranks = [LADDER.index(item) for item in verdicts if item in LADDER]
    if ranks and verdict in LADDER and LADDER.index(verdict) >= min(ranks):
        return []
    return [f"verdict {before['verdict']} -> {verdict}"]


def cost_faults(before: Row, after: Row, printed: float | None = None) -> list[str]:
    """Return a phrase if a solved exact stage costs more, or Table I is not reproduced any more.

    printed: the paper's cost of the stage, None if the paper has none.
    """
    costs, cost = _numbers(before, "cost"), _numbers(after, "cost")
    if not costs or not cost:
        return []
    if printed is not None:
        reproduced = any(abs(value - printed) < PRINTED for value in costs)
        if reproduced and abs(cost[0] - printed) >= PRINTED:
            return [f"Table I: cost {printed:.2f} -> {after['cost']}"]
    relaxed = any(" " in row["stage"].split(" #")[0] for row in (before, after))
    solved = "solved" in before["outcome"] and set(before["verdict"].split(SEPARATOR)) & set(HOLD)
    if relaxed or not solved or cost[0] <= max(costs) * (1.0 + COST_INCREASE):
        return []
    return [f"cost {before['cost']} -> {after['cost']}"]


def answer_faults(before: Row, after: Row) -> list[str]:
    """Return a phrase if a replay's distance from the closed form of its scene has changed."""
    values, value = _numbers(before, "answer_error"), _numbers(after, "answer_error")
    if not values or any(abs(value[0] - old) <= ROUNDING * old for old in values if value):
        return []
    return [f"answer_error {before['answer_error']} -> {after['answer_error'] or '-'}"]


def moved(before: Row, after: Row) -> list[str]:
    """Return the words and figures that lie outside the spread of the frozen campaigns."""
    found = [
        f"{name} {before[name]} -> {after[name]}"
        for name in ("outcome", "verdict")
        if after[name] not in before[name].split(SEPARATOR)
    ]
    for name in ("iterations", *FIGURES):
        values, value = _numbers(before, name), _numbers(after, name)
        if not values or not value:
            if bool(values) != bool(value):
                found.append(f"{name} {before[name] or '-'} -> {after[name] or '-'}")
            continue
        slack = FLOOR + COST_INCREASE * max(map(abs, values))
        if not min(values) - slack <= value[0] <= max(values) + slack:
            found.append(f"{name} {before[name]} -> {after[name]}")
    return found


def compared(before: Sequence[Row], after: Sequence[Row]) -> Iterator[tuple[str, str]]:
    """Yield (word, line) for each run and row: worse, missing, left, new, moved or kept.

    `missing` is a run whose pipeline still exists in the code; `left` is a run, stage or check
    that the code does not have any more.
    """
    old, new = ({key_of(row): row for row in campaign} for campaign in (before, after))
    old_lasts, new_lasts = ({key[:2]: key for key in rows} for rows in (old, new))
    printed = _paper_costs()
    for pair, key in old_lasts.items():
        name = " | ".join(pair)
        if pair in new_lasts:
            last = new[new_lasts[pair]]
            wrong = verdict_faults(old[key], last)
            wrong += cost_faults(old[key], last) if last["stage"] != old[key]["stage"] else []
            if wrong:
                yield "worse", f"{name}: {', '.join(wrong)}"
        elif pair[1] in pipeline_names():
            yield "missing", name
    for key in dict.fromkeys((*old, *new)):
        name = " | ".join(key)
        if key not in old or key not in new:
            yield ("new" if key in new else "left"), name
        elif wrong := (
            cost_faults(old[key], new[key], printed.get(key)) + answer_faults(old[key], new[key])
        ):
            yield "worse", f"{name}: {', '.join(wrong)}"
        else:
            words = moved(old[key], new[key])
            yield ("moved" if words else "kept"), f"{name}: {', '.join(words)}"


# Fields of a record that differ between two equal runs: seconds, places and worlds.
_OF_THE_CALL = {
    "shared_from", "survey", "provenance", "log_tail", "key", "seconds", "seconds_reference",
    "seconds_everyday", "wall_seconds", "cpu_seconds", "export_seconds", "check_seconds",
}  # fmt: skip


def bits(record: StageRecord | CheckRecord) -> str:
    """Return a hash of every number of a record except seconds, places and worlds."""

    def kept(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: kept(item) for name, item in value.items() if name not in _OF_THE_CALL}
        return [kept(item) for item in value] if isinstance(value, list) else value

    content = kept(to_data(record))
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _bits(folder: Path) -> dict[str, str]:
    stored = load(folder)
    stages = {
        f"{run.scene.name} | {run.pipeline} | {stage.index + 1}": bits(stage)
        for run in stored.runs
        for stage in run.stages
    }
    return stages | {
        f"{item.kind}: {item.name}, {item.scene}": bits(item) for item in stored.checks
    }


@click.group()
def command() -> None:
    """Freeze campaigns, or compare a campaign with the frozen ones."""


_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@command.command()
@click.argument("folders", nargs=-1, required=True, type=_FOLDER)
@click.option("--keep", is_flag=True, help="Add to the committed values instead of replacing them.")
def freeze(folders: tuple[Path, ...], keep: bool) -> None:
    """Write the results of the campaigns in FOLDERS, with their spread, to golden.csv."""
    campaigns: list[Iterable[Row]] = [list(rows(folder)) for folder in folders]
    found = merged([frozen(), *campaigns] if keep else campaigns)
    write(found)
    click.echo(f"{len(found)} rows in {GOLDEN}")


@command.command()
@campaign_argument
def compare(folder: Path) -> int:
    """Print what differs from the frozen campaigns. Exit code 1 if anything is worse or missing."""
    counts: Counter[str] = Counter()
    for word, line in compared(frozen(), list(rows(folder))):
        counts[word] += 1
        if word != "kept":
            click.echo(f"{word:8s}{line}")
    stored = load(folder)
    for sentence in failures(stored.runs, stored.checks):
        counts["failure"] += 1
        click.echo(f"failure {sentence}")
    click.echo(", ".join(f"{count} {word}" for word, count in counts.most_common()))
    return 1 if counts["worse"] or counts["missing"] or counts["failure"] else 0


@command.command()
@click.argument("first", type=_FOLDER)
@click.argument("second", type=_FOLDER)
def equal(first: Path, second: Path) -> int:
    """Print the stages and checks that differ in any number, seconds excepted; exit code 1 then."""
    before, after = _bits(first), _bits(second)
    differing = [
        key for key in sorted(before.keys() | after.keys()) if before.get(key) != after.get(key)
    ]
    for key in differing:
        click.echo(key)
    click.echo(f"{len(differing)} of {len(before.keys() | after.keys())} differ")
    return 1 if differing else 0


@command.command()
def table() -> None:
    """Print the frozen results of the paper's scene as the table of docs/results.md."""
    click.echo(results_table(), nl=False)


def results_table() -> str:
    """Return the stages of Table I and the last stage of each other pipeline as Markdown.

    A stage that several pipelines share is printed once. Of several frozen campaigns the first
    value is printed.
    """
    lines = [
        "| pipeline | stage | eps | cost | paper | error: plan | own grid | replay | verdict |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    firsts = [{name: row[name].split(SEPARATOR)[0] for name in COLUMNS} for row in frozen()]
    kept = [row for row in firsts if row["scene"] == SCENE and row["cost"]]
    seen: set[tuple[str, ...]] = set()
    for pipeline in PIPELINES:
        stages = [row for row in kept if row["pipeline"] == pipeline.name]
        paper = [f"{row.numbers['cost']:.2f}" for row in table_rows(pipeline.name)]
        for place, row in enumerate(stages):
            stage = (row["stage"], row["cost"])
            if stage in seen or (not paper and row is not stages[-1]):
                continue
            seen.add(stage)
            errors = (
                f"{float(row[name]):.2g}" if float(row[name]) > FLOOR else "0"
                for name in ("terminal_error", "discrete_terminal_error", "replay_terminal_error")
            )
            method, _, eps = row["stage"].split(" #")[0].partition(" ")
            costs = (f"{float(row['cost']):.2f}", paper[place] if paper else "")
            cells = (pipeline.name, method, eps, *costs, *errors, row["verdict"])
            lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(lines) + "\n"
