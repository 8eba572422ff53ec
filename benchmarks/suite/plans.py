"""`plans`: exact plans by every pipeline that ends in one, on scenes with friction and on random rows of carts: outcome, cost, iterations, CPU seconds.

A task is n = 3, 4, 5, 6, 3, .. carts (`cart_chain`) at random places, at rest. Its goal is where
random pushes of both ends inwards, that press every contact for less than half of the time and stop
after 4 of 5 s, have led: it can be reached for certain, and what is not solved is a failure.
`above` is how much more a plan costs than the cheapest that a pipeline found, as a part of it. What
DIR/plans.json holds already stays in the table, but for what is run again: pipelines can be added
to it one at a time.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np

from benchmarks.options import POSITIVE, out_option
from benchmarks.records import Table
from benchmarks.results import as_markdown, store_tables, tables_of
from formulations.pipelines import find_pipeline, pipeline_names, solve_stages
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scenes.cart_chain import LENGTH, cart_chain
from validate.cli.options import write, written_to

EXACT = ("strict", "relaxed+strict", "softplus_dc+strict", "mpcc", "best_exact")
SCENES = ("transport", "hopper_planar", "push_box", "two_finger", "two_finger_lift")
_STEPS = 300
_SECONDS = 5.0
_PIECES = 8  # pushes of so many sizes
# [N]
_MEAN = 3.0
_SPREAD = 5.0
_CASADI = "casadi"
_LEFT = 1e-6  # of rows and products of the reference: with more it is no exact plan
_COLUMNS = ("outcome", "verdict", "cost", "above", "iterations", "cpu")


def task(seed: int) -> Scene:
    """See the module docstring."""
    return pushed_row(seed, 3 + seed % 4, _STEPS)


def pushed_row(seed: int, n: int, steps: int) -> Scene:
    """n carts, pushed in the first four fifths of so many steps."""
    random, pushed = np.random.default_rng((seed, n)), steps * 4 // 5
    start = np.concatenate(
        [
            2.0 + np.concatenate([[0.0], np.cumsum(LENGTH + random.uniform(0.05, 0.5, n - 1))]),
            np.zeros(n),
        ]
    )
    scene = cart_chain(n).with_task(start=tuple(start), steps=steps, step=_SECONDS / steps)
    kernel, pieces = load_kernel(scene), np.arange(pushed) * _PIECES // pushed
    while True:
        u = np.zeros((steps, 2))
        u[:pushed] = (
            np.array([_MEAN, -_MEAN]) + random.uniform(-_SPREAD, _SPREAD, (_PIECES, 2))[pieces]
        )
        rollout = kernel.rollout(start, u, scene.task.step)
        pressed = rollout.lam > 0.0
        if pressed.any(axis=0).all() and pressed.mean() < 0.5:
            return scene.with_task(goal=(*map(float, rollout.q[-1]), *map(float, rollout.v[-1])))


def rows(tasks: int, only: str) -> Iterator[tuple[str, Scene]]:
    """The scenes and tasks whose names contain this text."""
    for name in SCENES:
        if only in name:
            yield name, load_scene(name)
    for seed in range(tasks):
        scene = task(seed)
        name = f"{scene.nq} carts, {seed}"
        if only in name:
            yield name, scene


def solved(
    name: str, scene: Scene, pipeline: str, time_limit: float, judged: bool
) -> dict[str, Any]:
    """What a pipeline finds, in this process."""
    begin = process_time()
    stages = list(solve_stages(scene, find_pipeline(pipeline), time_limit=time_limit))
    last, seconds = stages[-1], process_time() - begin
    row = {
        "row": name,
        "pipeline": pipeline,
        "outcome": last.outcome.name,
        "cost": last.cost,
        "cpu": seconds,
    }
    row["iterations"] = sum(stage.iterations for stage in stages)
    if judged and last.trajectory is not None:
        from validate.judge.judgement import judge

        row["verdict"] = judge(scene, last.trajectory).verdict.value
    return row


def reference(name: str, scene: Scene, time_limit: float) -> dict[str, Any]:
    """What CasADi finds: products bounded by ever smaller eps, from our softplus plan."""
    import casadi as ca
    import pyomo.environ as pyo

    from benchmarks.mpec.peer import casadi_scholtes, of_pyomo
    from formulations.transcription.build import build_model, load_plan

    begin = process_time()
    chain = find_pipeline("softplus_dc+strict")
    start = list(solve_stages(scene, replace(chain, legs=chain.legs[:1]), time_limit=time_limit))[
        -1
    ].trajectory
    model: Any = build_model(scene)
    if start is not None:
        load_plan(model, start)
    program, variables = of_pyomo(model)
    x = casadi_scholtes(program)
    for variable, value in zip(variables, x, strict=True):
        variable.set_value(value, skip_validation=True)
    function = ca.Function("left", [program.x], [program.rows, program.first * program.second])
    rows, products = (np.array(part).ravel() for part in function(x))
    left = max(
        np.maximum(program.rows_lower - rows, rows - program.rows_upper).max(),
        products.max(initial=0.0),
    )
    outcome = Outcome.SOLVED if left <= _LEFT else Outcome.STALLED
    cost, cpu = pyo.value(model.objective_cost), process_time() - begin
    return {"row": name, "pipeline": _CASADI, "outcome": outcome.name, "cost": cost, "cpu": cpu}


def compared(found: Iterable[dict[str, Any]]) -> None:
    """Write `above` into the rows."""
    solved = [run for run in found if run["outcome"] == Outcome.SOLVED.name]
    least = {
        name: min(run["cost"] for run in solved if run["row"] == name)
        for name in {run["row"] for run in solved}
    }
    for run in solved:
        run["above"] = run["cost"] / least[run["row"]] - 1.0


def _told(runs: Mapping[tuple[str, str], dict[str, Any]]) -> tuple[Table, Table]:
    """The costs, a column for each pipeline, and all runs."""
    rows, pipelines = (tuple(dict.fromkeys(key[place] for key in runs)) for place in (0, 1))
    solved = {
        key: run["cost"] for key, run in runs.items() if run["outcome"] == Outcome.SOLVED.name
    }
    counts = "; ".join(
        f"{name}: {sum(key[1] == name for key in solved)} of {sum(key[1] == name for key in runs)} solved"
        for name in pipelines
    )
    costs = tuple(
        (name, *(solved.get((name, pipeline)) for pipeline in pipelines)) for name in rows
    )
    every = tuple(
        (run["row"], run["pipeline"], *(run.get(name) for name in _COLUMNS))
        for run in runs.values()
    )
    return Table(caption=counts, columns=("row", *pipelines), rows=costs), Table(
        caption="Every run.", columns=("row", "pipeline", *_COLUMNS), rows=every
    )


@click.command()
@click.option(
    "--only", default="", metavar="TEXT", help="Scenes and tasks whose name contains this text."
)
@click.option(
    "--pipeline",
    "pipelines",
    multiple=True,
    type=click.Choice(pipeline_names()),
    metavar="NAME",
    help="Instead of all exact ones.",
)
@click.option(
    "--tasks",
    type=click.IntRange(min=0),
    default=20,
    show_default=True,
    help="Random rows of carts.",
)
@click.option(
    "--time-limit",
    type=POSITIVE,
    default=600.0,
    show_default=True,
    metavar="SECONDS",
    help="Wall time, for a row.",
)
@click.option(
    "--casadi",
    "with_casadi",
    is_flag=True,
    help="Beside CasADi, from our softplus plan, for the rows of carts.",
)
@click.option(
    "--judge", "judged", is_flag=True, help="Replay the plans of the scenes and judge them."
)
@written_to("--markdown", "markdown", "FILE.md", "the table of costs")
@out_option
def command(
    only: str,
    pipelines: tuple[str, ...],
    tasks: int,
    time_limit: float,
    with_casadi: bool,
    judged: bool,
    markdown: Path | None,
    out: Path,
) -> int:
    """Exact plans by every pipeline, on scenes with friction and on random rows of carts."""
    before = tables_of(out, "plans")
    runs = {
        (str(run["row"]), str(run["pipeline"])): dict(run)
        for run in (before.runs if before else ())
    }
    asked = list(rows(tasks, only))
    if not asked:
        raise click.UsageError(
            f"no scene or task has {only!r} in its name; there are {', '.join(SCENES)}, '3 carts, 0' .."
        )
    for name, scene in asked:
        for pipeline in (
            *(pipelines or EXACT),
            *([_CASADI] if with_casadi and name not in SCENES else []),
        ):
            if pipeline == _CASADI:
                found = reference(name, scene, time_limit)
            else:
                found = solved(name, scene, pipeline, time_limit, judged and name in SCENES)
            runs[name, pipeline] = found
            click.echo(
                f"{name} x {pipeline}: {found['outcome']}, {found['cost']}, {found['cpu']:.1f} CPU s",
                err=True,
            )
            compared(runs.values())
            _store(out, runs, quiet=True)
    costs = _store(out, runs, quiet=False)
    write(markdown, lambda: as_markdown(costs))
    return 0


def _store(out: Path, runs: Mapping[tuple[str, str], dict[str, Any]], *, quiet: bool) -> Table:
    tables = _told(runs)
    store_tables(
        out,
        "plans",
        "Exact plans by every pipeline",
        (__doc__ or "").split("\n\n")[0],
        tables,
        list(runs.values()),
        quiet=quiet,
    )
    return tables[0]
