"""Growth of time and memory with the size of the problem: n carts in a row, T steps.

    python benchmarks/bench_scaling.py [-o FILE.json] [--stage STAGE ..] [--largest NT] [--limit SECONDS]

Stages, each in a process of its own that has imported everything before the clock starts:

    softplus_dc    softplus collocation at eps = 1e-3 from a cold start: build, translate, solve
    mpec_step      one step of the relaxed complementarity from the softplus plan, eps = 1e-2: build, translate, solve
    mpcc           exact contact from a cold start: homotopy, modes, landing (no window search)
    gd_iteration   one loss and its gradient through the compiled rollout and adjoint
    replay         the everyday replay and the reference replay of the inputs, as `validate all` does

CPU seconds are of the process; memory is its largest resident set less that before the stage. The exponent is the slope of log(CPU s) over
log(n T), by least squares over all sizes; Ipopt's is given per iteration too, because the number of iterations is the problem's.
A report takes the file from DIR/bench/.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

SIZES = (
    (3, 500),
    (3, 1000),
    (3, 2000),
    (3, 5000),
    (3, 10000),
    (3, 20000),
    (5, 2000),
    (10, 500),
    (10, 2000),
    (10, 5000),
    (20, 500),
    (20, 1000),
    (20, 3000),
)


def scene_of(n: int, steps: int):
    """n carts in T steps of five seconds, for more than ten carts of n/2 seconds: twenty cannot be pushed to rest in five."""
    from models.scenes.cart_chain import cart_chain

    return cart_chain(n).with_task(steps=steps, step=max(5.0, n / 2) / steps)


def _resident() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _measured(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    before, began = _resident(), process_time()
    found = work()
    return {"cpu_s": process_time() - began, "memory_mib": max(0.0, _resident() - before), **found}


def _solved(method: str, scene: Any, eps: float | None, warm: Any = None, **options: object) -> tuple[Any, dict[str, Any]]:
    from formulations.catalog import load_method

    solution = load_method(method).open(scene, options).solve(eps=eps, warm_start=warm, time_limit=3600.0)
    return solution.trajectory, {"outcome": solution.outcome.name.lower(), "iterations": solution.iterations, "cost": solution.cost}


def _plan_of_full_push(scene: Any) -> Any:
    """Both ends driven inwards by a sine: contacts close and open, at any T."""
    from models.codegen.kernel import load_kernel
    from models.schemes import Scheme
    from models.trajectory import Trajectory, uniform_grid

    steps, step = scene.task.steps, scene.task.step
    push = 8.0 * np.sin(np.linspace(0.0, 2 * np.pi, steps, endpoint=False))
    u = np.stack([push, -push], axis=1)
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, step)
    return Trajectory(t=uniform_grid(step, steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER)


def _softplus(n: int, steps: int) -> dict[str, Any]:
    scene = scene_of(n, steps)
    _solved("softplus_dc", scene_of(3, 5), 1e-1)  # imports, compilation
    return _measured(lambda: _solved("softplus_dc", scene, 1e-3)[1])


def _mpec(n: int, steps: int) -> dict[str, Any]:
    scene = scene_of(n, steps)
    warm, _ = _solved("softplus_dc", scene, 1e-3)
    _solved("relaxed_lcp", scene_of(3, 5), 1e-1)
    return _measured(lambda: _solved("relaxed_lcp", scene, 1e-2, warm)[1])


def _mpcc(n: int, steps: int) -> dict[str, Any]:
    scene = scene_of(n, steps)
    _solved("mpcc", scene_of(3, 50), None, search_windows=0)
    return _measured(lambda: _solved("mpcc", scene, None, search_windows=0)[1])


def _gradient(n: int, steps: int) -> dict[str, Any]:
    from models.codegen.kernel import load_kernel

    scene = scene_of(n, steps)
    kernel, plan = load_kernel(scene), _plan_of_full_push(scene)
    start = np.array(scene.task.start)
    bars = np.zeros_like(plan.q), np.zeros_like(plan.v)
    bars[0][-1], bars[1][-1] = 1.0, 1.0

    def iteration() -> None:
        rollout = kernel.rollout(start, plan.u, scene.task.step)
        kernel.adjoint(rollout, plan.u, *bars, cost_bar=1.0)

    iteration()
    repeats = max(5, 2_000_000 // (n * steps))

    def work() -> dict[str, Any]:
        for _ in range(repeats):
            iteration()
        return {"outcome": "solved", "iterations": repeats, "cost": None}

    found = _measured(work)
    return {**found, "cpu_s": found["cpu_s"] / repeats, "iterations": 1}


def _replay(n: int, steps: int) -> dict[str, Any]:
    from models.fmu import build_fmu
    from validate.replay import replay

    scene = scene_of(n, steps)
    fmu, plan = build_fmu(scene), _plan_of_full_push(scene)
    small = scene_of(n, 20)
    replay(small, fmu, _plan_of_full_push(small))

    def work() -> dict[str, Any]:
        result = replay(scene, fmu, plan)
        return {"outcome": result.outcome.name.lower(), "iterations": 1, "cost": None}

    return _measured(work)


STAGES: dict[str, Callable[[int, int], dict[str, Any]]] = {
    "softplus_dc": _softplus,
    "mpec_step": _mpec,
    "mpcc": _mpcc,
    "gd_iteration": _gradient,
    "replay": _replay,
}


def _exponent(rows: list[dict[str, Any]], column: Callable[[dict[str, Any]], float]) -> float | None:
    """Slope of log(column) over log(n T); None with fewer than three sizes."""
    points = [(np.log(row["n"] * row["steps"]), np.log(column(row))) for row in rows if column(row) > 0]
    if len(points) < 3:
        return None
    return float(np.polyfit(*np.array(points).T, 1)[0])


def _run(stage: str, n: int, steps: int, limit: float) -> dict[str, Any]:
    command = [sys.executable, __file__, "--one", stage, str(n), str(steps)]
    began = perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return {
            "n": n,
            "steps": steps,
            "outcome": f"no answer in {limit:g} s",
            "cpu_s": None,
            "memory_mib": None,
            "iterations": 0,
            "cost": None,
        }
    if done.returncode != 0:
        raise SystemExit(f"{stage}, n = {n}, T = {steps}: {done.stderr.strip().splitlines()[-1:]}")
    found = json.loads(done.stdout.strip().splitlines()[-1])
    print(
        f"  n = {n:2d}, T = {steps:5d}: {found['cpu_s']:10.5f} CPU s, {found['memory_mib']:8.1f} MiB, {found['iterations']} iterations, "
        f"{found['outcome']} ({perf_counter() - began:.0f} s)",
        flush=True,
    )
    return {"n": n, "steps": steps, **found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", action="append", choices=sorted(STAGES), help="only this stage; may be repeated")
    parser.add_argument(
        "--largest", type=int, default=60_000, metavar="NT", help="leave out sizes with a larger n T (default: %(default)s)"
    )
    parser.add_argument("--limit", type=float, default=900.0, metavar="SECONDS", help="for one process (default: %(default)s)")
    parser.add_argument("--one", nargs=3, metavar=("STAGE", "N", "T"), help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, help="write all numbers as JSON")
    arguments = parser.parse_args()
    if arguments.one:
        stage, n, steps = arguments.one
        print(json.dumps(STAGES[stage](int(n), int(steps))))
        return
    told = []
    for stage in arguments.stage or STAGES:
        print(stage, flush=True)
        rows = [_run(stage, n, steps, arguments.limit) for n, steps in SIZES if n * steps <= arguments.largest]
        done = [row for row in rows if row["cpu_s"] is not None]
        figures = {
            "time_exponent": _exponent(done, lambda row: row["cpu_s"]),
            "iteration_exponent": _exponent(done, lambda row: row["cpu_s"] / max(1, row["iterations"])),
            "memory_exponent": _exponent(done, lambda row: row["memory_mib"]),
        }
        print("  " + ", ".join(f"{name} {value:.3f}" for name, value in figures.items() if value is not None), flush=True)
        told.append({"name": stage, **figures, "rows": rows})
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps({"kind": "scaling", "stages": told}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
