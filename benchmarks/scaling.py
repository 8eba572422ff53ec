"""Growth of time and memory with the size of the problem: n carts in a row, T steps.

Each stage of each size is a child of its own (benchmarks.measure) that has imported everything
before the clock starts:

    softplus_dc    softplus collocation at eps = 1e-3 from a cold start: build, translate, solve
    mpec_step      one step of the relaxed complementarity from the softplus plan, eps = 1e-2:
                   build, translate, solve
    mpcc           exact contact from a cold start: homotopy, modes, landing (no window search)
    gd_iteration   one loss and its gradient through the compiled rollout and adjoint
    replay         the everyday replay and the reference replay of the inputs, as `validate all`
                   does
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.measure import Size, Work, sample, slope
from benchmarks.options import POSITIVE, out_option
from benchmarks.results import store
from benchmarks.suite.carts import push, pushed_plan, scene_of
from validate.store.disk import temporary_folder

SIZES = tuple(
    Size(*size)
    for size in (
        (3, 500), (3, 1000), (3, 2000), (3, 5000), (3, 10000), (3, 20000), (5, 2000), (10, 500),
        (10, 2000), (10, 5000), (20, 500), (20, 1000), (20, 3000),
    )
)  # fmt: skip
# name -> function of this file, and whether its work is done once only.
STAGES = {
    "softplus_dc": True,
    "mpec_step": True,
    "mpcc": True,
    "gd_iteration": False,
    "replay": True,
}


def _solved(
    method: str, scene: Any, eps: float | None, warm: Any = None, **options: object
) -> tuple[Any, Mapping[str, Any]]:
    from formulations.pipelines import load_method

    solution = (
        load_method(method).open(scene, options).solve(eps=eps, warm_start=warm, time_limit=3600.0)
    )
    return solution.trajectory, {
        "outcome": solution.outcome.name.lower(),
        "iterations": solution.iterations,
        "value": solution.cost,
    }


def softplus_dc(size: Size, folder: Path) -> Work:
    scene = scene_of(size)
    _solved("softplus_dc", scene_of(Size(3, 5)), 1e-1)  # imports, compilation
    return lambda: _solved("softplus_dc", scene, 1e-3)[1]


def mpec_step(size: Size, folder: Path) -> Work:
    scene = scene_of(size)
    warm, _ = _solved("softplus_dc", scene, 1e-3)
    _solved("relaxed_lcp", scene_of(Size(3, 5)), 1e-1)
    return lambda: _solved("relaxed_lcp", scene, 1e-2, warm)[1]


def mpcc(size: Size, folder: Path) -> Work:
    scene = scene_of(size)
    _solved("mpcc", scene_of(Size(3, 50)), None, search_windows=0)
    return lambda: _solved("mpcc", scene, None, search_windows=0)[1]


def gd_iteration(size: Size, folder: Path) -> Work:
    from models.codegen.kernel import load_kernel

    scene, u = scene_of(size), push(size.steps)
    kernel, start = load_kernel(scene), np.array(scene.task.start)
    bars = np.zeros((2, size.steps + 1, size.n))
    bars[:, -1] = 1.0

    def work() -> Mapping[str, Any]:
        rollout = kernel.rollout(start, u, scene.task.step)
        kernel.adjoint(rollout, u, *bars, cost_bar=1.0)
        return {"outcome": "solved", "iterations": 1}

    return work


def replay(size: Size, folder: Path) -> Work:
    from models.fmu import build_fmu
    from validate.judge.replay.run import replay as replayed

    scene, plan = scene_of(size), pushed_plan(size)
    small = Size(size.n, 20)
    fmu = build_fmu(scene)
    replayed(scene_of(small), fmu, pushed_plan(small))
    return lambda: {"outcome": replayed(scene, fmu, plan).outcome.name.lower(), "iterations": 1}


def _row(stage: str, size: Size, limit: float, folder: Path) -> dict[str, Any]:
    found = sample(
        f"benchmarks.scaling:{stage}",
        size,
        folder,
        seconds=limit,
        what=f"{stage}, {size}",
        once=STAGES[stage],
    )
    told = (
        found.failed
        or f"{found.cpu_s:10.5f} CPU s, {found.memory_mib:8.1f} MiB, {found.iterations} iterations, {found.outcome}"
    )
    click.echo(f"  {size}: {told}")
    return {
        "n": size.n, "steps": size.steps, "cpu_s": found.cpu_s, "memory_mib": found.memory_mib,
        "iterations": found.iterations,
        "outcome": found.failed or found.outcome, "cost": found.value,
    }  # fmt: skip


def exponents(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    """Slopes over n T of what has an answer.

    Ipopt's time an iteration too, because the number of iterations is the problem's.
    """
    done = [row for row in rows if row["cpu_s"] is not None]

    def growth(name: str, per_iteration: bool = False) -> float | None:
        return slope(
            (
                row["n"] * row["steps"],
                row[name] / (max(1, row["iterations"]) if per_iteration else 1),
            )
            for row in done
        )

    return {
        "time_exponent": growth("cpu_s"),
        "iteration_exponent": growth("cpu_s", True),
        "memory_exponent": growth("memory_mib"),
    }


@click.command()
@click.option(
    "--stage",
    "stages",
    type=click.Choice(list(STAGES)),
    multiple=True,
    help="Only this stage; may be repeated.",
)
@click.option(
    "--largest", type=click.IntRange(min=min(size.n * size.steps for size in SIZES)),
    default=60_000, show_default=True, metavar="NT",
    help="Leave out sizes with a larger n T.",
)  # fmt: skip
@click.option(
    "--limit",
    type=POSITIVE,
    default=900.0,
    show_default=True,
    metavar="SECONDS",
    help="For one process.",
)
@out_option
def command(stages: tuple[str, ...], largest: int, limit: float, out: Path) -> int:
    """CPU time and memory of five stages over n carts and T steps, and the exponents of n T."""
    told: list[dict[str, Any]] = []
    with temporary_folder("touchstone-bench-") as folder:
        for stage in stages or STAGES:
            click.echo(stage)
            rows = [
                _row(stage, size, limit, folder) for size in SIZES if size.n * size.steps <= largest
            ]
            figures = exponents(rows)
            click.echo(
                "  "
                + ", ".join(
                    f"{name} {value:.3f}" for name, value in figures.items() if value is not None
                )
            )
            told.append({"name": stage, **figures, "rows": rows})
            store(out, "scaling", {"kind": "scaling", "stages": told})
    return 0
