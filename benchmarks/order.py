"""Step size and order: which grid gives a plan that its replay confirms to 1e-2, 1e-3, 1e-4 m, and at what CPU time.

Each scene is planned on ever finer grids with exact contact: by semi-implicit Euler (`mpcc` without
its window search) and by collocation of order 2, 3 and 5 (`collocation`), all from the paper's
first guess, all by the same softplus homotopy. The running cost is weighed with the step, so that
every grid approximates one problem; collocation minimises its quadrature. Scenes with friction are
planned by semi-implicit Euler alone, by softplus collocation and then `strict_lcp`: neither of the
others knows friction.

    replay error   largest position difference between plan and replay at the plan's nodes [m, rad],
                   by the reference replay
    plan error     the same between the plan and the finest plan of the highest order: how far from
                   the optimum of the continuous problem
    switch error   the bound that `collocation` gives for what opening and closing contacts cost
                   [m/s, rad/s]

CPU seconds are those of opening and solving in this process, the least of the repeats (as many as 5
s allow); compiling the scene is not in them. The order is the slope of log(replay error) over
log(h), by least squares.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from benchmarks.measure import least, slope
from benchmarks.options import COUNT, POSITIVE, out_option
from benchmarks.results import store
from formulations.pipelines import find_pipeline, load_method, solve_stages, stage_plan
from formulations.solution import Solution
from models.catalog import load_scene
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory
from validate.judge.replay.run import replay

EULER = Scheme.SEMI_IMPLICIT_EULER.value
FINEST = Scheme.RADAU_IIA_3.value
COLLOCATIONS = (Scheme.IMPLICIT_MIDPOINT.value, Scheme.RADAU_IIA_2.value, FINEST)
# Steps of the whole horizon: those of Euler, those of collocation; the last of collocation is also
# the finest plan. Scenes without inputs have nothing to plan.
GRIDS: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "three_cart": ((50, 100, 200, 500, 1000, 2000), (25, 50, 100, 200, 400)),
    "two_discs": ((60, 120, 240, 480, 960), (30, 60, 120, 240, 480)),
    "wall_pendulum": ((10, 20, 40, 80, 160, 320), (5, 10, 20, 40, 80)),
    "cart_pole_walls": ((50, 100, 200, 400, 800), (25, 50, 100, 200)),
    "hopper": ((100, 200, 400, 800), (50, 100, 200, 400)),
    "cart_chain": ((125, 250, 500, 1000), (62, 125, 250, 500)),
    "acrobot_limits": ((500, 1000, 2000), (125, 250, 500, 1000)),
    "two_discs_wall": ((240, 480, 960), (60, 120, 240, 480)),
    "two_finger": ((250, 500, 1000), (125, 250, 500)),
    "transport": ((100, 200, 400, 800, 1600), ()),
    "push_box": ((25, 50, 100, 200, 400), ()),
    "two_finger_lift": ((100, 200, 400, 800), ()),
    "hopper_planar": ((100, 200, 400), ()),
}
_FRICTION_CHAIN = "softplus_dc+strict"
TARGETS = (1e-2, 1e-3, 1e-4)
# Repeats stop here [CPU s]: longer solves vary little.
_ENOUGH = 5.0
# Relative tolerances of the replay: 1e-9 m or better, far below every error that is told.
_TOLERANCES = (1e-9, 1e-11)


def on_grid(scene: Scene, steps: int) -> Scene:
    """The same task in so many steps, its running cost weighed with the step."""
    task = scene.task
    step = task.horizon / steps
    return scene.with_task(
        steps=steps, step=step, running_cost=task.running_cost * (step / task.step)
    )


def _solve(scene: Scene, scheme: str, limit: float) -> Solution:
    if scene.frictions:
        return _solve_chain(scene, limit)
    if scheme == EULER:
        method, options = load_method("mpcc"), {"search": False}
    else:
        method, options = load_method("collocation"), {"scheme": scheme, "integrate_cost": True}
    with method.open(scene, options) as session:
        return session.solve(eps=None, warm_start=None, time_limit=limit)


def _solve_chain(scene: Scene, limit: float) -> Solution:
    """Iterations are those of all stages, the rest is the last one's.

    A stage without a plan hands on the one before, as in a campaign.
    """
    pipeline = find_pipeline(_FRICTION_CHAIN)
    solutions = list(
        solve_stages(scene, pipeline, time_limit=limit * len(list(stage_plan(pipeline))))
    )
    return replace(solutions[-1], iterations=sum(solution.iterations for solution in solutions))


def _row(
    scene: Scene, fmu: Path, scheme: str, steps: int, limit: float, repeats: int
) -> tuple[dict[str, Any], Trajectory | None]:
    grid = on_grid(scene, steps)
    solution, cpu = least(lambda: _solve(grid, scheme, limit), repeats, _ENOUGH)
    plan, error = solution.trajectory, None
    if plan is not None:
        found = replay(grid, fmu, plan, tolerances=_TOLERANCES, track=False)
        error = float(np.abs(found.q[found.knots] - plan.q).max()) if found.ok else None
    row = {
        "scheme": scheme,
        "steps": steps,
        "h": grid.task.step,
        "outcome": solution.outcome.name.lower(),
        "cpu_s": cpu,
        "iterations": solution.iterations,
        "cost": solution.cost,
        "replay_error": error,
        "plan_error": None,
        "switch_error": solution.residuals.get("switch_error"),
    }
    told = "-" if error is None else f"{error:.2e}"
    click.echo(
        f"  {scheme:20s} {steps:5d} steps: {row['outcome']}, replay error {told}, {cpu:.2f} CPU s"
    )
    return row, plan


def _answer(rows: list[dict[str, Any]], target: float) -> dict[str, Any]:
    """The cheapest grid within the target, of all schemes and of Euler alone."""
    within = [
        row
        for row in rows
        if row["outcome"] == "solved"
        and row["replay_error"] is not None
        and row["replay_error"] <= target
    ]
    best: dict[str, Any] = {"target": target}
    for name, chosen in (
        ("best", within),
        ("euler", [row for row in within if row["scheme"] == EULER]),
    ):
        row = min(chosen, key=lambda row: row["cpu_s"], default=None)
        best[name] = (
            None
            if row is None
            else {key: row[key] for key in ("scheme", "steps", "cpu_s", "replay_error")}
        )
    return best


def measure(name: str, most: int, limit: float, repeats: int) -> dict[str, Any]:
    """One scene: all rows of grids of at most so many steps, the order of each scheme, and the answers."""
    scene = load_scene(name)
    fmu, (euler, collocation) = (
        build_fmu(scene),
        (tuple(steps for steps in grids if steps <= most) for grids in GRIDS[name]),
    )
    for scheme in (EULER, FINEST) if collocation else (EULER,):  # imports and compilation
        _solve(on_grid(scene, min(collocation or euler)), scheme, limit)
    found = [
        _row(scene, fmu, scheme, steps, limit, repeats)
        for scheme, grids in ((EULER, euler), *((scheme, collocation) for scheme in COLLOCATIONS))
        for steps in grids
    ]
    finest = next(
        (
            plan
            for row, plan in reversed(found)
            if row["scheme"] == FINEST and row["outcome"] == "solved"
        ),
        None,
    )
    if finest is not None:
        reference = CubicHermiteSpline(finest.t, finest.q, finest.v)
        for row, plan in found:
            if plan is not None and plan is not finest:
                row["plan_error"] = float(np.abs(plan.q - reference(plan.t)).max())
    rows = [row for row, _ in found]
    solved = [row for row in rows if row["outcome"] == "solved" and row["replay_error"]]
    schemes = dict.fromkeys(row["scheme"] for row in rows)
    orders = {
        scheme: slope((row["h"], row["replay_error"]) for row in solved if row["scheme"] == scheme)
        for scheme in schemes
    }
    for scheme, order in orders.items():
        click.echo(f"  {scheme:20s} order {'-' if order is None else f'{order:.2f}'}")
    answers = [_answer(rows, target) for target in TARGETS]
    for answer in answers:
        best = answer["best"]
        told = (
            "no grid"
            if best is None
            else f"{best['scheme']}, {best['steps']} steps, {best['cpu_s']:.2f} CPU s"
        )
        click.echo(f"  within {answer['target']:g}: {told}")
    return {
        "name": name,
        "unit": ", ".join(dict.fromkeys(item.unit for item in scene.coordinates)),
        "horizon": scene.task.horizon,
        "orders": orders,
        "rows": rows,
        "answers": answers,
    }


@click.command()
@click.option(
    "--scene",
    "scenes",
    type=click.Choice(sorted(GRIDS)),
    multiple=True,
    help="Only this scene; may be repeated.",
)
@click.option("--most", type=COUNT, default=10**6, metavar="STEPS", help="Leave out finer grids.")
@click.option(
    "--limit",
    type=POSITIVE,
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    help="For one solve.",
)
@click.option(
    "--repeats", type=COUNT, default=3, show_default=True, help="Most solves of one grid."
)
@out_option
def command(scenes: tuple[str, ...], most: int, limit: float, repeats: int, out: Path) -> int:
    """Which grid and scheme give a plan that its replay confirms to 1e-2, 1e-3, 1e-4 m, and at what CPU time."""
    for name in scenes or GRIDS:
        coarsest = min(sum(GRIDS[name], ()))
        if most < coarsest:
            raise click.UsageError(
                f"--most {most} leaves no grid of {name}, whose coarsest has {coarsest} steps."
            )
    told = []
    for name in scenes or GRIDS:
        click.echo(name)
        told.append(measure(name, most, limit, repeats))
        store(out, "order", {"kind": "order", "scenes": told})
    return 0
