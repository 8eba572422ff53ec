"""The optimum of the two discs as their contact gets stiffer, against the optimum of rigid discs.

Both variants (with and without the wall), from soft to stiff; the grid gets finer with the contact,
so that omega h <= 0.35, omega^2 = 2 k/m. At the softest, constant forces are tried on a grid, the
throws that end nearest to the goal are bent until they end in it (strict complementarity, the goal
given), and let go again. Each stiffer contact starts from the cheapest few plans of the one before
- what is cheapest in soft contact need not be the cheapest in stiff contact -: L-BFGS through the
true contact, then strict complementarity; the cheapest plan counts. Its inputs are then replayed
through the continuous dynamics: the cost of what really happens stands beside the plan's own. The
integral of abs(u)^2 is the same on every grid: its weight goes with the step.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np

from benchmarks.options import COUNT, POSITIVE, out_option
from benchmarks.results import store
from formulations.grids import on_grid
from formulations.pipelines import load_method
from formulations.solution import Solution
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from models.scene.parts import goal_limits
from models.scenes.two_discs import MASS, RIGID_OPTIMUM, RIGID_OPTIMUM_WALL, two_discs
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay.run import replay

_SWEEP = (
    (500, 480),
    (2000, 480),
    (5000, 960),
    (20000, 1920),
    (100000, 3840),
    (200000, 5760),
    (400000, 7680),
    (1000000, 11520),
)
# Constant forces tried in each direction at the softest contact, and how many of the throws are
# gone on with.
_FORCES = 81
_THROWS = 6
# How many plans are gone on with from one stiffness to the next, and by how much their costs differ
# at least.
_KEPT = 3
_APART = 1e-3


def _scene(wall: bool, k: float, steps: int) -> Scene:
    scene = two_discs(wall=wall).with_parameters(k=k)
    task = scene.task
    return scene.with_task(
        steps=steps, step=task.horizon / steps, running_cost=task.running_cost * task.steps / steps
    )


def _solved(method: str, scene: Scene, start: Trajectory | None, seconds: float) -> Solution:
    with load_method(method).open(scene) as session:
        return session.solve(eps=None, warm_start=start, time_limit=seconds)


def _throws(scene: Scene) -> list[Trajectory]:
    """The motions under constant forces that touch and end nearest to the goal."""
    kernel, start, steps = load_kernel(scene), np.array(scene.task.start), scene.task.steps
    forces = [np.linspace(item.lower, item.upper, _FORCES) for item in scene.inputs]
    found = []
    for pair in itertools.product(*forces):
        u = np.tile(pair, (steps, 1))
        motion = kernel.rollout(start, u, scene.task.step)
        if not motion.diverged and (motion.lam > 0).any():
            missed = float((motion.q[-1, 2:4] ** 2).sum())
            scheme, t = Scheme.SEMI_IMPLICIT_EULER, uniform_grid(scene.task.step, steps)
            found.append(
                (
                    missed,
                    Trajectory(t=t, q=motion.q, v=motion.v, u=u, lam=motion.lam, scheme=scheme),
                )
            )
    return [plan for _, plan in sorted(found, key=lambda item: item[0])[:_THROWS]]


def _bent(scene: Scene, plans: list[Trajectory], seconds: float) -> list[Trajectory]:
    """The same throws, ending in the goal, as far as that is found."""
    asked = replace(
        scene, limits=(*scene.limits, *goal_limits(position=0.01, reason="as law_error"))
    )
    into = asked.with_task(goal=(None, None, 0.0, 0.0, None, None, None, None))
    solutions = [_solved("strict_lcp", into, plan, seconds) for plan in plans]
    return [solution.trajectory for solution in solutions if solution.trajectory is not None]


def _let_go(scene: Scene, plan: Trajectory, seconds: float) -> list[tuple[str, Solution]]:
    first = _solved("relu_lbfgs", scene, plan, seconds)
    return [
        ("L-BFGS", first),
        ("strict", _solved("strict_lcp", scene, first.trajectory or plan, seconds)),
    ]


def _replayed_cost(scene: Scene, plan: Trajectory) -> float | None:
    """The cost with the end that the continuous dynamics lead to.

    None if the replay did not get there.
    """
    found = replay(scene, build_fmu(scene), plan)
    if not found.ok:
        return None
    centre = found.end[2:4]  # of disc 2
    return _weight(scene) * float((plan.u**2).sum()) + float(centre @ centre)


def _weight(scene: Scene) -> float:
    """Of u^2 in the running cost, per step."""
    cost = scene.task.running_cost
    return float(
        cost.subs(
            {item.symbol: 1.0 if index == 0 else 0.0 for index, item in enumerate(scene.inputs)}
        )
    )


def _row(
    wall: bool, k: float, steps: int, before: list[Trajectory], seconds: float
) -> tuple[dict[str, Any], list[Trajectory]]:
    """The figures of one stiffness, and the plans to go on with, the cheapest first."""
    scene = _scene(wall, k, steps)
    began = process_time()
    starts = (
        [on_grid(plan, scene) for plan in before]
        if before
        else _bent(scene, _throws(scene), seconds)
    )
    tries = [
        (f"{words} from start {place}", solution)
        for place, plan in enumerate(starts, 1)
        for words, solution in _let_go(scene, plan, seconds)
    ]
    found = [
        (words, solution)
        for words, solution in tries
        if solution.trajectory is not None and solution.cost is not None
    ]
    row: dict[str, Any] = {
        "k": float(k),
        "steps": steps,
        "omega_h": math.sqrt(2 * k / MASS) * scene.task.step,
        "outcomes": {words: solution.outcome.name.lower() for words, solution in tries},
        "costs": {words: solution.cost for words, solution in tries},
        "cost": None,
        "replayed_cost": None,
    }
    kept: list[tuple[float, Trajectory]] = []
    for _, solution in sorted(found, key=lambda pair: float(pair[1].cost or 0.0)):
        cost, plan = float(solution.cost or 0.0), solution.trajectory
        if (
            plan is not None
            and len(kept) < _KEPT
            and all(abs(cost - other) > _APART * abs(other) for other, _ in kept)
        ):
            kept.append((cost, plan))
    if kept:
        row["cost"], row["replayed_cost"] = kept[0][0], _replayed_cost(scene, kept[0][1])
    row["cpu_s"] = process_time() - began
    return row, [plan for _, plan in kept]


def _pairs(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> list[tuple[float, int]]:
    found = []
    for value in values:
        k, _, steps = value.partition(":")
        try:
            found.append((POSITIVE(k, parameter, context), COUNT(steps, parameter, context)))
        except click.BadParameter as error:
            raise click.BadParameter(
                f"{value!r}: write k [N/m], a colon, steps, such as 5000:960.", context, parameter
            ) from error
    return found


@click.command()
@click.option(
    "--stiffness", "sweep", multiple=True, default=[f"{k}:{steps}" for k, steps in _SWEEP],
    callback=_pairs, metavar="K:STEPS",
    help="k [N/m] and steps; may be repeated, from soft to stiff.",
)  # fmt: skip
@click.option(
    "--variant",
    type=click.Choice(["free", "wall", "both"]),
    default="both",
    show_default=True,
    help="Without a wall, with it.",
)
@click.option("--seconds", type=POSITIVE, default=120.0, show_default=True, help="For each solve.")
@out_option
def command(sweep: list[tuple[float, int]], variant: str, seconds: float, out: Path) -> int:
    """The optimum of the two discs as their contact gets stiffer, against the optimum of rigid discs."""
    cases = [
        {"name": "two_discs", "title": "Two discs", "rigid": RIGID_OPTIMUM, "rows": []},
        {
            "name": "two_discs_wall",
            "title": "Two discs and a wall",
            "rigid": RIGID_OPTIMUM_WALL,
            "rows": [],
        },
    ]
    for case, wall in zip(cases, (False, True), strict=True):
        if variant == ("free" if wall else "wall"):
            continue
        before: list[Trajectory] = []
        for k, steps in sweep:
            row, plans = _row(wall, k, steps, before, seconds)
            before = plans or before
            case["rows"].append(row)
            told = (
                "no plan"
                if row["cost"] is None
                else f"{row['cost']:.6f} ({100 * (row['cost'] / case['rigid'] - 1):+.3f} %)"
            )
            click.echo(
                f"{case['name']} k = {k:g}, {steps} steps, omega h = {row['omega_h']:.3f}: {told}, replayed {row['replayed_cost']}, {row['cpu_s']:.1f} CPU s"
            )
            store(
                out,
                "rigid-limit",
                {"kind": "rigid_limit", "cases": [case for case in cases if case["rows"]]},
            )
    return 0
