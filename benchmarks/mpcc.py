"""Method mpcc from a cold start, on the paper's scene and around it: outcome, cost, residuals, certificate, CPU seconds.

The three_cart rows are whole processes: CPU seconds of a fresh Python with imports, model and
solve. The others run here, one after the other; their CPU seconds are those of opening and solving.
J*h compares grids: cost is a sum over steps. `class` is what `formulations.mpec` says of the plan,
from the strict Pyomo model and multipliers of its own.

Random scenes: rows of 2 to 5 carts, the outer ones driven (of two, the left one), with random
masses, damping, stiffness (20 to 3000 N/m, within half the stability limit of the grid), horizon,
steps and start. kind `rest`: three carts from rest to rest; `roll`: the goal is where random inputs
lead, so that it can be reached for certain, moving in general; `far`: out of reach.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np
import sympy as sp

from benchmarks.measure import run_child
from benchmarks.options import POSITIVE, out_option
from benchmarks.records import Table
from benchmarks.results import store_tables
from formulations.mpec.certificate.plan import certify_plan
from formulations.pipelines import load_method
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Contact, Coordinate, Input, Parameter, Scene, Task
from models.scene.parts import goal_limits

_COLUMNS = ("outcome", "cost", "cost_h", "complementarity", "terminal", "class", "tried", "cpu")


@dataclass(frozen=True)
class Case:
    """name; scene; search, start (a number of `mpcc`'s starts)."""

    name: str
    scene: Scene
    start: int = 0


def cases(random_scenes: int) -> Iterator[Case]:
    three = load_scene("three_cart")
    for k in (30.0, 300.0, 3000.0):
        for steps in (250, 500, 1000):
            yield Case(
                f"k={k:g} T={steps}",
                three.with_parameters(k=k).with_task(steps=steps, step=5.0 / steps),
            )
    for start in range(20):
        yield Case(f"start {start}", three, start)
    for seed in range(random_scenes):
        for kind in ("rest", "roll"):
            yield Case(f"random {kind} {seed}", random_scene(seed, kind))
    for seed in range(max(1, random_scenes // 5)):
        yield Case(f"random far {seed}", random_scene(seed, "far"))


def random_scene(seed: int, kind: str) -> Scene:
    """See the module docstring."""
    random = np.random.default_rng((seed, ("rest", "roll", "far").index(kind)))
    carts = 3 if kind == "rest" else int(random.choice([2, 3, 3, 3, 4, 5]))
    masses, damping, steps = (
        random.uniform(0.5, 2.0, carts),
        random.uniform(0.2, 3.0),
        int(random.integers(100, 600)),
    )
    step = random.uniform(3.0, 8.0) / steps
    stable = (4.0 - 2.0 * step * damping / masses.min()) / step**2 * masses.min() / 4.0
    stiffness = min(10.0 ** random.uniform(1.3, 3.5), 0.5 * stable)
    start = np.concatenate(
        [
            np.cumsum(random.uniform(0.52, 1.2, carts)),
            random.uniform(-0.3, 0.3, carts) * (random.random() < 0.5),
        ]
    )
    inputs = 1 if carts == 2 else 2
    scene = _chain(masses, damping, stiffness, inputs, start, start, step, steps)
    if kind == "rest":
        places = np.cumsum(random.uniform(0.52, 1.2, carts))
        goal = np.concatenate(
            [places - places[1] + start[1] + random.uniform(-0.8, 0.8), np.zeros(carts)]
        )
        return _chain(masses, damping, stiffness, inputs, start, goal, step, steps)
    for _ in range(200):
        u = (
            4.0 * random.uniform(-1.0, 1.0, (10, inputs))[np.arange(steps) * 10 // steps]
            + np.array([2.0, -2.0])[:inputs]
        )
        rollout = load_kernel(scene).rollout(start, u, step)
        if (
            not rollout.diverged
            and (rollout.lam > 0).any(axis=0).all()
            and (rollout.lam > 0).mean() < 0.5
        ):
            break
    goal = np.concatenate([rollout.q[-1], rollout.v[-1]])
    if kind == "far":
        goal[0] -= 500.0
    return _chain(masses, damping, stiffness, inputs, start, goal, step, steps)


def _chain(
    masses: np.ndarray,
    damping: float,
    stiffness: float,
    inputs: int,
    start: np.ndarray,
    goal: np.ndarray,
    step: float,
    steps: int,
) -> Scene:
    n = len(masses)
    q, v, m = (sp.symbols(f"{letter}1:{n + 1}", real=True) for letter in "qvm")
    c, k, d = sp.symbols("c k d", real=True)
    u = sp.symbols(f"u1:{inputs + 1}", real=True)
    forces = [-c * speed for speed in v]
    for index, force in zip((0, n - 1), u, strict=False):
        forces[index] += force
    values = [
        *zip(m, masses, ["kg"] * n, strict=True),
        (c, damping, "N s/m"),
        (k, stiffness, "N/m"),
        (d, 0.5, "m"),
    ]
    return Scene(
        name=f"chain_of_{n}",
        title="A random row of carts",
        source="benchmarks/mpcc.py",
        coordinates=tuple(
            Coordinate(symbol=a, velocity=b, unit="m") for a, b in zip(q, v, strict=True)
        ),
        inputs=tuple(Input(symbol=symbol, unit="N", lower=-10.0, upper=10.0) for symbol in u),
        parameters=tuple(
            Parameter(symbol=symbol, value=float(value), unit=unit, lower=0.0)
            for symbol, value, unit in values
        ),
        kinetic_energy=sum((a * b**2 for a, b in zip(m, v, strict=True)), sp.Integer(0)) / 2,
        potential_energy=sp.Integer(0),
        forces=tuple(forces),
        contacts=tuple(
            Contact(
                name=f"contact{i + 1}",
                bodies=(f"cart {i + 1}", f"cart {i + 2}"),
                penetration=d - (q[i + 1] - q[i]),
                stiffness=k,
                depth=d,
                depth_reason="the length of a cart: there the centres coincide",
                nominal=0.1,
            )
            for i in range(n - 1)
        ),
        task=Task(
            start=tuple(start),
            goal=tuple(goal),
            running_cost=sum((x**2 for x in u), sp.Integer(0)),
            step=step,
            steps=steps,
        ),
        limits=goal_limits(position=0.05, velocity=0.1, reason="as of three_cart"),
    )


def run(case: Case, time_limit: float) -> dict[str, Any]:
    """One row, in this process."""
    begin, scene = process_time(), case.scene
    with load_method("mpcc").open(scene, {"first_start": case.start}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=time_limit)
    row: dict[str, Any] = {
        "name": case.name,
        "outcome": solution.outcome.name,
        "cpu": process_time() - begin,
    }
    if solution.trajectory is not None and solution.cost is not None:
        row |= {
            "cost": solution.cost,
            "cost_h": solution.cost * scene.task.step,
            "complementarity": solution.residuals["complementarity"],
            "terminal": solution.residuals["discrete_terminal_error"],
            "tried": int(solution.residuals["windows_tried"]),
            "class": certify_plan(scene, solution.trajectory).stationarity.letter,
        }
    return row


def three_cart(steps: int, search: bool, time_limit: float) -> None:
    """One solve, told on stdout: what a child does."""
    scene = load_scene("three_cart").with_task(steps=steps, step=5.0 / steps)
    with load_method("mpcc").open(scene, {"search": search}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=time_limit)
    click.echo(
        json.dumps({"outcome": solution.outcome.name, "cost": solution.cost, "cpu": process_time()})
    )


def as_process(name: str, steps: int, search: bool, time_limit: float) -> dict[str, Any]:
    """One row, as a process of its own."""
    done = run_child("benchmarks.mpcc", str(steps), str(int(search)), str(time_limit))
    if done.returncode:
        raise click.ClickException(
            f"{name}: its process ended with code {done.returncode}: {done.stderr.strip()[-200:]}"
        )
    found = json.loads(done.stdout)
    return {"name": name, **found, "cost_h": found["cost"] * 5.0 / steps if found["cost"] else None}


@click.command()
@click.option("--only", default="", metavar="TEXT", help="Rows whose name contains this text.")
@click.option(
    "--random",
    "random_scenes",
    type=click.IntRange(min=0),
    default=20,
    show_default=True,
    help="Random scenes of each kind.",
)
@click.option(
    "--time-limit",
    type=POSITIVE,
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="Wall time, for a row.",
)
@out_option
def command(only: str, random_scenes: int, time_limit: float, out: Path) -> int:
    """`mpcc` from a cold start: outcome, cost, residuals, certificate, CPU seconds."""
    children = {
        "three_cart, no search": (500, False),
        "three_cart": (500, True),
        "three_cart T=5000": (5000, True),
    }
    rows = [
        as_process(name, *child, time_limit) for name, child in children.items() if only in name
    ]
    for case in cases(random_scenes):
        if only in case.name:
            rows.append(run(case, time_limit))
            click.echo(f"{case.name}: {rows[-1]['outcome']}, {rows[-1]['cpu']:.2f} CPU s", err=True)
    if not rows:
        raise click.UsageError(
            f"no row's name contains {only!r}; there are {', '.join(children)}, k=.. T=.., start 0 to 19, random .."
        )
    solved = sum(row["outcome"] == "SOLVED" for row in rows)
    told = Table(
        caption=f"{solved} of {len(rows)} solved, {sum(row['cpu'] for row in rows):.0f} CPU s.",
        columns=("row", *_COLUMNS),
        rows=tuple((row["name"], *(row.get(name) for name in _COLUMNS)) for row in rows),
    )
    store_tables(
        out, "mpcc", "mpcc from a cold start", (__doc__ or "").split("\n\n")[0], [told], rows
    )
    return 0


if __name__ == "__main__":
    three_cart(int(sys.argv[1]), sys.argv[2] == "1", float(sys.argv[3]))
