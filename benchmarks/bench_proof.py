"""What can be proved about contact plans: optimum or bound, gap, seconds and nodes. Run by hand; takes about ten minutes.

    python benchmarks/bench_proof.py                       # all rows
    python benchmarks/bench_proof.py --only three_cart:20 --json proof.json

Rows: `wall_pendulum` (20 steps), `three_cart` over its 5 s in 20, 25, 30 and 50 steps (h = 5/T) with the seconds given to each, and in its own 500
steps, where only the convex relaxation is asked: 998 decisions are out of reach. `--disjunction` adds the route by `mpec.simple_disjunction` and
`gdp.bigm` for three_cart in 20 steps, with the same M, to compare formulations. `local` is the cheapest plan of methods mpcc and strict_lcp.

Assumed: nothing but the scene. In T = 500 the bounds of the penetrations come from the energy argument proved in formulations/proof/energy.py.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import pyomo.environ as pyo

from formulations.catalog import load_method
from formulations.proof import build_miqp, pair_bounds, prove, relaxed_bound
from formulations.proof.bounds import physical_bounds
from formulations.proof.prove import scip
from formulations.solution import Outcome, Solution
from formulations.windows.linear_scene import linear_scene
from models.catalog import load_scene
from models.scene import Scene

ROWS = (
    ("wall_pendulum", 20, 60.0),
    ("three_cart", 20, 60.0),
    ("three_cart", 25, 60.0),
    ("three_cart", 30, 200.0),
    ("three_cart", 50, 200.0),
)
HEAD = (
    f"{'scene':14} {'T':>4} {'local':>12} {'cost':>13} {'bound':>13} {'gap':>8} {'wall s':>7} {'CPU s':>7} {'nodes':>7} {'open':>9}  status"
)


def on_grid(name: str, steps: int) -> Scene:
    """The scene over the same seconds in so many steps."""
    scene = load_scene(name)
    return scene if steps == scene.task.steps else scene.with_task(steps=steps, step=scene.task.horizon / steps)


def local(scene: Scene) -> Solution | None:
    """The cheapest exact plan of the local methods."""
    found = []
    for name in ("mpcc", "strict_lcp"):
        with load_method(name).open(scene) as session:
            solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
        if solution.outcome is Outcome.SOLVED and solution.cost is not None:
            found.append(solution)
    return min(found, key=lambda solution: solution.cost or 0.0, default=None)


def proved(name: str, steps: int, seconds: float) -> dict[str, Any]:
    scene = on_grid(name, steps)
    start = local(scene)
    proof = prove(scene, incumbent=None if start is None else start.trajectory, time_limit=seconds)
    return {
        "scene": name,
        "T": steps,
        "given_s": seconds,
        "local": None if start is None else start.cost,
        "cost": proof.cost,
        "bound": proof.bound,
        "gap": proof.gap,
        "wall_s": proof.seconds,
        "cpu_s": proof.cpu,
        "nodes": proof.nodes,
        "open": f"{proof.binaries}/{proof.pairs}",
        "status": proof.status.name,
        "solver": proof.solver,
    }


def relaxed(name: str) -> dict[str, Any]:
    """The scene's own grid: the convex relaxation with bounds from physics."""
    scene = load_scene(name)
    start = local(scene)
    cost = None if start is None else start.cost
    begin, cpu = perf_counter(), process_time()
    linear = linear_scene(scene)
    bounds = physical_bounds(scene, linear, float("inf") if cost is None else cost * (1.0 + 1e-5))
    bound = relaxed_bound(linear, bounds.lower, bounds.upper, bounds.ceiling)
    return {
        "scene": name,
        "T": scene.task.steps,
        "local": cost,
        "cost": cost,
        "bound": bound,
        "gap": None if cost is None else (cost - bound) / cost,
        "wall_s": perf_counter() - begin,
        "cpu_s": process_time() - cpu,
        "nodes": 0,
        "open": f"{int((~bounds.decided[1:]).sum())}/{bounds.decided[1:].size}",
        "status": "RELAXED",
    }


def by_disjunction(steps: int, seconds: float) -> dict[str, Any]:
    """Two binaries a pair and one M for all: Pyomo's own transformations on the same bounds."""
    scene = on_grid("three_cart", steps)
    start = local(scene)
    linear = linear_scene(scene)
    begin, cpu = perf_counter(), process_time()
    bounds = pair_bounds(scene, linear, float("inf") if start is None or start.cost is None else start.cost * (1.0 + 1e-5))
    model: Any = build_miqp(scene, bounds)
    for component in (model.constraint_pair, model.variable_closed):
        model.del_component(component)
    model.complementarity_contact.activate()
    pyo.TransformationFactory("mpec.simple_disjunction").apply_to(model)
    largest = float(max(abs(bounds.lower).max(), abs(bounds.upper).max()) * linear.k.max())
    pyo.TransformationFactory("gdp.bigm").apply_to(model, bigM={None: 2.0 * largest})
    result = scip(model, seconds)
    cost, bound = result.incumbent_objective, min(float(result.objective_bound), bounds.ceiling)
    return {
        "scene": "  disjunction",
        "T": steps,
        "given_s": seconds,
        "local": None if start is None else start.cost,
        "cost": cost,
        "bound": bound,
        "gap": None if cost is None else (cost - bound) / cost,
        "wall_s": perf_counter() - begin,
        "cpu_s": process_time() - cpu,
        "nodes": int(result.extra_info["NNodes"]),
        "open": f"{2 * int((~bounds.decided[1:]).sum())}/{2 * bounds.decided[1:].size}",
        "status": result.termination_condition.name,
    }


def line(row: dict[str, Any]) -> str:
    def number(value: Any, form: str) -> str:
        return "-" if value is None else format(value, form)

    return (
        f"{row['scene']:14} {row['T']:>4} {number(row['local'], '.6f'):>12} {number(row['cost'], '.6f'):>13} {number(row['bound'], '.6f'):>13} "
        f"{number(row['gap'], '.1%'):>8} {row['wall_s']:>7.1f} {row['cpu_s']:>7.1f} {row['nodes']:>7} {row['open']:>9}  {row['status']}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="one row, as SCENE:STEPS")
    parser.add_argument("--disjunction", action="store_true", help="also the route by mpec.simple_disjunction and gdp.bigm")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(HEAD)

    def add(row: dict[str, Any]) -> None:
        rows.append(row)
        print(line(row), flush=True)

    for name, steps, seconds in ROWS:
        if arguments.only in (None, f"{name}:{steps}"):
            add(proved(name, steps, seconds))
    if arguments.only in (None, "three_cart:500"):
        add(relaxed("three_cart"))
    if arguments.disjunction:
        add(by_disjunction(20, 60.0))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
