"""What can be proved about contact plans: optimum or bound, gap, seconds and nodes.

Rows: `wall_pendulum` (20 steps), `three_cart` over its 5 s in 20, 25, 30 and 50 steps (h = 5/T)
    with the seconds given to each, and in its own 500
steps, where only the convex relaxation is asked: 998 decisions are out of reach. `--disjunction`
    adds the route by `mpec.simple_disjunction` and
`gdp.bigm` for three_cart in 20 steps, with the same M, to compare formulations. `local` is the
    cheapest plan of methods mpcc and strict_lcp.

Assumed: nothing but the scene. In T = 500 the bounds of the penetrations come from the energy
    argument proved in formulations/proof/bounds.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import click
import pyomo.environ as pyo

from benchmarks.options import out_option
from benchmarks.records import Table
from benchmarks.results import store_tables
from formulations.contact_modes.linear import linear_scene
from formulations.pipelines import load_method
from formulations.proof import build_miqp, pair_bounds, prove, relaxed_bound
from formulations.proof.bounds import physical_bounds
from formulations.proof.prove import scip
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.scene import Scene

ROWS = (
    ("wall_pendulum", 20, 60.0),
    ("three_cart", 20, 60.0),
    ("three_cart", 25, 60.0),
    ("three_cart", 30, 200.0),
    ("three_cart", 50, 200.0),
)
# The row of which the convex relaxation alone is asked.
_RELAXED = "three_cart:500"
COLUMNS = ("T", "local", "cost", "bound", "gap", "wall_s", "cpu_s", "nodes", "open", "status")


def on_grid(name: str, steps: int) -> Scene:
    """The scene over the same seconds in so many steps."""
    scene = load_scene(name)
    return (
        scene
        if steps == scene.task.steps
        else scene.with_task(steps=steps, step=scene.task.horizon / steps)
    )


def local(scene: Scene) -> Solution | None:
    """The cheapest exact plan of the local methods."""
    found = []
    for name in ("mpcc", "strict_lcp"):
        with load_method(name).open(scene) as session:
            solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
        if solution.outcome is Outcome.SOLVED and solution.cost is not None:
            found.append(solution)
    return min(found, key=lambda solution: solution.cost or 0.0, default=None)


def _row(scene: str, steps: int, start: Solution | None, **found: Any) -> dict[str, Any]:
    """What is found of a scene, beside the local methods' best plan."""
    return {"scene": scene, "T": steps, "local": None if start is None else start.cost, **found}


def proved(name: str, steps: int, seconds: float) -> dict[str, Any]:
    scene = on_grid(name, steps)
    start = local(scene)
    proof = prove(scene, incumbent=None if start is None else start.trajectory, time_limit=seconds)
    return _row(
        name, steps, start, given_s=seconds, cost=proof.cost, bound=proof.bound, gap=proof.gap,
        wall_s=proof.seconds, cpu_s=proof.cpu, nodes=proof.nodes,
        open=f"{proof.binaries}/{proof.pairs}", status=proof.status.name, solver=proof.solver,
    )  # fmt: skip


def relaxed(name: str) -> dict[str, Any]:
    """The scene's own grid: the convex relaxation with bounds from physics."""
    scene = load_scene(name)
    start = local(scene)
    cost = None if start is None else start.cost
    begin, cpu = perf_counter(), process_time()
    linear = linear_scene(scene)
    bounds = physical_bounds(scene, linear, float("inf") if cost is None else cost * (1.0 + 1e-5))
    bound = relaxed_bound(linear, bounds.lower, bounds.upper, bounds.ceiling)
    return _row(
        name, scene.task.steps, start, cost=cost, bound=bound,
        gap=None if cost is None else (cost - bound) / cost,
        wall_s=perf_counter() - begin, cpu_s=process_time() - cpu, nodes=0,
        open=f"{int((~bounds.decided[1:]).sum())}/{bounds.decided[1:].size}", status="RELAXED",
    )  # fmt: skip


def by_disjunction(steps: int, seconds: float) -> dict[str, Any]:
    """Two binaries a pair and one M for all: Pyomo's own transformations on the same bounds."""
    scene = on_grid("three_cart", steps)
    start = local(scene)
    linear = linear_scene(scene)
    begin, cpu = perf_counter(), process_time()
    bounds = pair_bounds(
        scene,
        linear,
        float("inf") if start is None or start.cost is None else start.cost * (1.0 + 1e-5),
    )
    model: Any = build_miqp(scene, bounds)
    for component in (model.constraint_pair, model.variable_closed):
        model.del_component(component)
    model.complementarity_contact.activate()
    pyo.TransformationFactory("mpec.simple_disjunction").apply_to(model)
    largest = float(max(abs(bounds.lower).max(), abs(bounds.upper).max()) * linear.k.max())
    pyo.TransformationFactory("gdp.bigm").apply_to(model, bigM={None: 2.0 * largest})
    result = scip(model, seconds)
    cost, bound = result.incumbent_objective, min(float(result.objective_bound), bounds.ceiling)
    return _row(
        "three_cart, disjunction", steps, start, given_s=seconds, cost=cost, bound=bound,
        gap=None if cost is None else (cost - bound) / cost,
        wall_s=perf_counter() - begin, cpu_s=process_time() - cpu,
        nodes=int(result.extra_info["NNodes"]),
        open=f"{2 * int((~bounds.decided[1:]).sum())}/{2 * bounds.decided[1:].size}",
        status=result.termination_condition.name,
    )  # fmt: skip


@click.command()
@click.option(
    "--only",
    type=click.Choice([*(f"{name}:{steps}" for name, steps, _ in ROWS), _RELAXED]),
    help="One row, a scene and its steps.",
)
@click.option(
    "--disjunction", is_flag=True, help="Also the route by mpec.simple_disjunction and gdp.bigm."
)
@out_option
def command(only: str | None, disjunction: bool, out: Path) -> int:
    """What can be proved about contact plans: optimum or bound, gap, seconds and nodes.

    Takes about ten minutes.
    """
    asked: list[Callable[[], dict[str, Any]]] = [
        partial(proved, *row) for row in ROWS if only in (None, f"{row[0]}:{row[1]}")
    ]
    if only in (None, _RELAXED):
        asked.append(lambda: relaxed("three_cart"))
    if disjunction:
        asked.append(lambda: by_disjunction(20, 60.0))
    rows = []
    for ask in asked:
        rows.append(ask())
        click.echo(
            f"{rows[-1]['scene']}, T = {rows[-1]['T']}: {rows[-1]['status']}, {rows[-1]['wall_s']:.1f} s",
            err=True,
        )
    told = Table(
        caption="Cost of the local methods' best plan, and what is proved; open: contact decisions that bounds leave to the search, of all.",
        columns=("scene", *COLUMNS),
        rows=tuple((row["scene"], *(row[name] for name in COLUMNS)) for row in rows),
    )
    store_tables(out, "proof", "What can be proved", (__doc__ or "").split("\n\n")[0], [told], rows)
    return 0
