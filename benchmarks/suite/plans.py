"""`plans`: exact plans of random rows of carts by several pipelines: outcome, cost, iterations, CPU seconds.

A task is n = 3, 4, 5, 6, 3, .. carts (`cart_chain`) at random places, at rest. Its goal is where
random pushes of both ends inwards have led, which press every contact for less than half of the
time and stop after 4 of 5 s: it can be reached, so that an unsolved task is a failure. `above` is
how much more a plan costs than the cheapest plan of its task, as a share of that.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np

from benchmarks.options import COUNT, POSITIVE, out_option
from benchmarks.results import as_markdown, as_text, store
from formulations.pipelines import find_pipeline, pipeline_names, solve_stages
from formulations.solution import Outcome
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scenes.cart_chain import LENGTH, cart_chain
from validate.cli.options import write, written_to

EXACT = ("strict", "relaxed+strict", "softplus_dc+strict", "mpcc", "best_exact")
_STEPS = 300
_SECONDS = 5.0
_PIECES = 8  # pushes of so many sizes
# [N]
_MEAN = 3.0
_SPREAD = 5.0
_CASADI = "casadi"
_LEFT = 1e-6  # of rows and products of CasADi's point: with more it is no exact plan
_COLUMNS = ("row", "pipeline", "outcome", "cost", "above", "iterations", "cpu")


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


def solved(name: str, scene: Scene, pipeline: str, time_limit: float) -> dict[str, Any]:
    """Solve by a pipeline, in this process."""
    begin = process_time()
    stages = list(solve_stages(scene, find_pipeline(pipeline), time_limit=time_limit))
    return {
        "row": name,
        "pipeline": pipeline,
        "outcome": stages[-1].outcome.name,
        "cost": stages[-1].cost,
        "iterations": sum(stage.iterations for stage in stages),
        "cpu": process_time() - begin,
    }


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


@click.command()
@click.option(
    "--pipeline",
    "pipelines",
    multiple=True,
    type=click.Choice(pipeline_names()),
    default=EXACT,
    show_default=True,
    metavar="NAME",
)
@click.option("--tasks", type=COUNT, default=20, show_default=True, help="Random rows of carts.")
@click.option(
    "--time-limit",
    type=POSITIVE,
    default=600.0,
    show_default=True,
    metavar="SECONDS",
    help="Wall time of one pipeline on one row.",
)
@click.option("--casadi", "with_casadi", is_flag=True, help="CasADi too, from our softplus plan.")
@written_to("--markdown", "markdown", "FILE.md", "the table of costs")
@out_option
def command(
    pipelines: tuple[str, ...], tasks: int, time_limit: float, with_casadi: bool,
    markdown: Path | None, out: Path,
) -> int:  # fmt: skip
    """Exact plans of random rows of carts, by several pipelines."""
    ways = (*pipelines, *((_CASADI,) if with_casadi else ()))
    runs = []
    for seed in range(tasks):
        scene = task(seed)
        name = f"{scene.nq} carts, {seed}"
        for way in ways:
            solve = (name, scene, time_limit)
            run = reference(*solve) if way == _CASADI else solved(name, scene, way, time_limit)
            told = f"{run['outcome']}, {run['cost']}, {run['cpu']:.1f} CPU s"
            click.echo(f"{name} x {way}: {told}", err=True)
            runs.append(run)
    compared(runs)
    costs = {
        (run["row"], run["pipeline"]): run["cost"]
        for run in runs
        if run["outcome"] == Outcome.SOLVED.name
    }
    names = dict.fromkeys(run["row"] for run in runs)
    table = [(name, *(costs.get((name, way)) for way in ways)) for name in names]
    click.echo(as_text(("row", *ways), table))
    counts = (f"{way}: {sum(key[1] == way for key in costs)} of {tasks} solved" for way in ways)
    click.echo("; ".join(counts) + "\n")
    click.echo(as_text(_COLUMNS, [[run.get(name) for name in _COLUMNS] for run in runs]))
    store(out, "plans", {"runs": runs})
    write(markdown, lambda: as_markdown(("row", *ways), table))
    return 0
