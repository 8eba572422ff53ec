"""How near other simulators come: MuJoCo's tendons to our replay, by the step.

Our FMU and Drake's CENIC to the exact motion, by CPU time.

The exact motion is our event-exact integration (models.exact_motion). Plans are those of the
verdict matrix; a scene without inputs is left alone for its task's time. Errors are the largest of
any position at the nodes [m], CPU seconds those of stepping, of one run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from benchmarks.verdict_matrix import kept_plan, plans_option
from models.catalog import load_scene
from models.exact_motion import Equations, Piece, true_motion
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid
from models.trajectory_netcdf import read_netcdf
from validate.judge.replay.run import replay
from validate.judge.simulator import Came, Drive, run_engine

# Scenes whose contacts are tendons with a dead band, and shares of the plan's step.
TENDONS = ("three_cart", "cart_chain", "two_discs")
SHARES = (50, 100, 200, 400)
# Our tolerance on each scene, and CENIC's accuracies.
EXACT = {
    "bouncing_mass": 1e-9,
    "two_body_collision": 1e-9,
    "damped_collision": 1e-9,
    "transport": 1e-11,
}
ACCURACIES = (1e-5, 1e-7, 1e-9)


def plan_of(scene: Scene, plans: Path) -> Trajectory:
    """The plan that is kept, or nothing for the task's time where there are no inputs.

    Raises TouchstoneError, ClickException without a plan.
    """
    if scene.nu:
        file = kept_plan(scene.name, plans)
        if file is None:
            raise click.ClickException(f"{scene.name}: without a plan there is nothing to measure.")
        return read_netcdf(file, scene)
    nothing = np.zeros((scene.task.steps + 1, 0))
    return Trajectory(
        t=uniform_grid(scene.task.step, scene.task.steps),
        q=nothing,
        v=nothing,
        u=nothing[1:],
        lam=nothing[1:],
    )


def told(engine: str, drives: Sequence[Drive], true: np.ndarray) -> list[str]:
    """Error and CPU time of each drive, true (nodes, nq) [m, rad]; or why there is none.

    Raises MachineError.
    """
    answer = run_engine(engine, drives)
    if answer.came is not Came.DONE:
        return [answer.why]
    return [
        f"{np.abs(motion.q - true).max():.1e} in {motion.seconds:.2g} s"
        for motion in answer.motions
    ]


def row(*cells: str) -> None:
    """A row of a table in Markdown. Raises nothing."""
    click.echo(f"| {' | '.join(cells)} |")


@click.command()
@plans_option
def command(plans: Path) -> int:
    """MuJoCo's tendons beside our replay, Drake's CENIC and our FMU beside exact motions."""
    row("scene", *(f"1/{share}" for share in SHARES))
    for name in TENDONS:
        scene = load_scene(name)
        plan = plan_of(scene, plans)
        ours = replay(scene, build_fmu(scene), plan, track=False)
        drives = [Drive(scene=scene, plan=plan, start=plan.start, parts=share) for share in SHARES]
        row(name, *told("mujoco", drives, ours.q[ours.knots]))
    row("scene", "our FMU", *(f"CENIC, accuracy {accuracy:g}" for accuracy in ACCURACIES))
    for name, tolerance in EXACT.items():
        scene = load_scene(name)
        plan = plan_of(scene, plans)
        start = np.array(scene.task.start, dtype=float)
        pieces = [Piece(end=float(end), u=u) for end, u in zip(plan.t[1:], plan.u, strict=True)]
        true = np.vstack([start, true_motion(Equations(scene), pieces, plan.t[1:])])[:, : scene.nq]
        base = Drive(scene=scene, plan=plan, start=start)
        ours = told("fmu", [replace(base, tolerance=tolerance)], true)
        row(
            name,
            *ours,
            *told(
                "drake_cenic", [replace(base, tolerance=accuracy) for accuracy in ACCURACIES], true
            ),
        )
    return 0
