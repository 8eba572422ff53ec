"""Every plan that a campaign stored, judged by the rule of today, beside what its record says: what a change of the rule changes, and why.

    python -m benchmarks rejudge runs/all --json rejudged.json
    python -m benchmarks rejudge runs/all --scene three_cart --all

Prints a row for each stage whose verdict changed (`--all`: each stage), with the sentence of today;
then counts. Equal plans are judged once.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import click

from benchmarks.options import COUNT, campaign_argument, json_option
from models.catalog import load_scene, scene_names
from models.errors import TouchstoneError
from models.trajectory_netcdf import read_netcdf
from validate.processes.disk import write_durably


def stages(
    folder: Path, scenes: tuple[str, ...]
) -> Iterator[tuple[dict[str, Any], dict[str, Any], Path]]:
    """(record, stage, file of its plan) of every stage with a plan, on scenes of this package."""
    known = scenes or scene_names()
    for path in sorted(folder.glob("runs/*/record.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        if "stages" not in record or record["scene"]["name"] not in known:
            continue
        last = len(record["stages"]) - 1
        for stage in record["stages"]:
            # the last stage's file has no number
            name = (
                "trajectory.nc" if stage["index"] == last else f"trajectory_{stage['index'] + 1}.nc"
            )
            file = path.parent / name
            if stage.get("has_plan") and file.is_file():
                yield record, stage, file


def judged(scene: str, file: Path) -> tuple[str, str, dict[str, Any]]:
    """Verdict, sentence and metrics (value, limit, ok) of today."""
    from validate.judge.judgement import judge

    loaded = load_scene(scene)
    try:
        found = judge(loaded, read_netcdf(file, loaded))
    except TouchstoneError as error:
        return "refused", str(error), {}
    return (
        found.verdict.value,
        found.score.why,
        {item.name: (item.value, item.limit, item.ok) for item in found.score.metrics},
    )


@click.command()
@campaign_argument
@click.option(
    "--scene",
    "scenes",
    type=click.Choice(scene_names()),
    multiple=True,
    help="Only this scene; may be given again.",
)
@click.option(
    "--all", "everything", is_flag=True, help="Every stage, not only those whose verdict changed."
)
@click.option("-j", "jobs", type=COUNT, default=1, show_default=True)
@json_option
def command(
    folder: Path, scenes: tuple[str, ...], everything: bool, jobs: int, file: Path | None
) -> int:
    """Judge the stored plans of a campaign anew."""
    found = list(stages(folder, scenes))
    contents = {file: (record["scene"]["name"], file.read_bytes()) for record, _, file in found}
    first = {content: file for file, content in reversed(contents.items())}
    with ProcessPoolExecutor(jobs) as pool:
        answers = dict(
            zip(
                first.values(),
                pool.map(judged, [scene for scene, _ in first], first.values()),
                strict=True,
            )
        )
    rows = []
    for record, stage, plan in found:
        of_stage = {name: stage[name] for name in ("method", "kind", "eps", "outcome")}
        judgement = dict(
            zip(("after", "why", "metrics"), answers[first[contents[plan]]], strict=True)
        )
        where = {
            "scene": record["scene"]["name"],
            "pipeline": record["pipeline"],
            "stage": stage["index"],
        }
        rows.append({**where, **of_stage, "before": stage["verdict"], **judgement})
    for row in rows:
        if everything or row["before"] != row["after"]:
            eps = "" if row["eps"] is None else f" {row['eps']:g}"
            told = f"{row['scene']} | {row['pipeline']} {row['stage']} | {row['method']}{eps}"
            click.echo(f"{told} | {row['before']} -> {row['after']} | {row['why']}")
    for (kind, before, after), count in sorted(
        Counter((row["kind"], row["before"], row["after"]) for row in rows).items()
    ):
        click.echo(f"{count:5d}  {kind:9s} {before} -> {after}")
    if file is not None:
        write_durably(file, json.dumps(rows, indent=0))
    return 0
