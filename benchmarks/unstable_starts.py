"""How many starts of the unstable cart-pole are balanced, in the tracked replay and in the open loop: cart_pole_walls from seeded random starts.

Starts: the cart within +-0.3 m, the pole within +-0.4 rad, at rest, uniformly. The plan is found by
    softplus_dc+strict from a cold start, with the
scene's cost (100 |x_T|^2 + 0.001 sum u^2) and a free end. Where it does not balance, the same is
    tried again with 93 and 85 % of the inputs' bounds: a plan that
stands at its bounds leaves the feedback nothing to correct with. A start is balanced by a plan that
    holds when it is judged on the scene itself (its
goal, all of its bounds, its limits, the one on the tracked replay's end among them); the open
    loop's end stands beside it. The wall is used where
the tracked replay presses on it. CPU seconds are those of this process: plan (models and
    translations too) and judgement apart, imports and compilation before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np

from benchmarks.options import COUNT, SEED, out_option
from benchmarks.results import store
from formulations.pipelines import find_pipeline, solve_stages, stage_plan
from models.catalog import load_scene
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.replay import Replay
from validate.judge.replay.run import replay
from validate.judge.score import Score, score

SCENE = "cart_pole_walls"
PIPELINE = "softplus_dc+strict"
# [m], [rad]
PLACE = 0.3
ANGLE = 0.4
# Shares of the inputs' bounds that plans are tried with, in this order.
SHARES = (1.0, 0.93, 0.85)
_TIME_LIMIT = 60.0  # [s] for a stage, on the average


@dataclass(frozen=True)
class Tried:
    """A plan, what it does, and CPU seconds of finding and of judging it."""

    share: float
    outcome: str
    plan: Trajectory | None
    replay: Replay | None
    score: Score | None
    plan_s: float
    judge_s: float

    @property
    def holds(self) -> bool:
        return self.score is not None and self.score.verdict.is_good


def starts(number: int, seed: int) -> np.ndarray:
    """(number, 4) x, theta, and zero velocities."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-1.0, 1.0, (number, 2)) * [PLACE, ANGLE]
    return np.hstack([drawn, np.zeros((number, 2))])


def _planned(scene: Scene) -> tuple[str, Trajectory | None]:
    """The pipeline from a cold start: the last outcome, and the last plan."""
    outcome, plan, pipeline = "no plan", None, find_pipeline(PIPELINE)
    for solution in solve_stages(
        scene, pipeline, time_limit=_TIME_LIMIT * len(list(stage_plan(pipeline)))
    ):
        outcome, plan = solution.outcome.name.lower(), solution.trajectory or plan
    return outcome, plan


def _tried(scene: Scene, fmu: Path, start: np.ndarray, share: float) -> Tried:
    began = process_time()
    inputs = tuple(
        replace(item, lower=share * item.lower, upper=share * item.upper) for item in scene.inputs
    )
    free = (None,) * (2 * scene.nq)
    judged = scene.with_task(start=tuple(start))
    outcome, plan = _planned(replace(judged.with_task(goal=free), inputs=inputs))
    middle = process_time()
    if plan is None:
        return Tried(share, outcome, None, None, None, middle - began, 0.0)
    found = replay(judged, fmu, plan, track=True)
    told = score(judged, plan, found)
    return Tried(share, outcome, plan, found, told, middle - began, process_time() - middle)


def _row(start: np.ndarray, tried: list[Tried]) -> dict[str, Any]:
    """The plan that holds, or the last one."""
    best = tried[-1]
    value = best.score.value if best.score is not None else lambda name: None
    tracked = best.replay.tracked if best.replay is not None else None
    impulse = (
        tracked.contact_impulse[-1].sum()
        if tracked is not None and tracked.contact_impulse is not None
        else 0.0
    )
    return {
        "x": float(start[0]), "theta": float(start[1]), "share": best.share,
        "outcome": best.outcome, "balanced": best.holds,
        "why": best.score.why if best.score is not None else "no plan",
        "wall_impulse": float(impulse),
        "tracked_end": value("tracked_replay_terminal_error"),
        "open_end": value("replay_terminal_error"), "plan_end": value("terminal_error"),
        "effort": value("feedback_effort"), "peak": value("feedback_peak"),
        "amplification": value("amplification"),
        "plan_cpu_s": sum(item.plan_s for item in tried),
        "judge_cpu_s": sum(item.judge_s for item in tried),
    }  # fmt: skip


@click.command()
@click.option("--starts", "number", type=COUNT, default=100, show_default=True)
@click.option("--seed", type=SEED, default=1, show_default=True)
@out_option
def command(number: int, seed: int, out: Path) -> int:
    """How many random starts of cart_pole_walls are balanced, in the tracked replay and in the open loop."""
    scene = load_scene(SCENE)
    fmu = build_fmu(scene)
    rows = []
    for place, start in enumerate(starts(number, seed), start=1):
        tried: list[Tried] = []
        for share in SHARES:
            tried.append(_tried(scene, fmu, start, share))
            if tried[-1].holds:
                break
        row = _row(start, tried)
        rows.append(row)
        click.echo(
            f"{place:4d}  x {start[0]:+.3f} m  theta {start[1]:+.3f} rad  {'balanced' if row['balanced'] else '--------'}  with {row['share']:.0%}  "
            f"end tracked {_told(row['tracked_end'])} open {_told(row['open_end'])}  effort {_told(row['effort'])}  "
            f"wall {row['wall_impulse']:.2f} N s  {row['plan_cpu_s']:.2f} + {row['judge_cpu_s']:.2f} CPU s"
            + ("" if row["balanced"] else f"  {row['why']}"),
            err=True,
        )
    balanced = [row for row in rows if row["balanced"]]
    walls = [row for row in balanced if row["wall_impulse"] > 0]
    cpu = [row["plan_cpu_s"] for row in rows]
    click.echo(
        f"{len(balanced)} of {len(rows)} starts balanced in the tracked replay, {len(walls)} of them by a wall; "
        f"CPU seconds of finding a plan: median {np.median(cpu):.2f}, at most {max(cpu):.2f}"
    )
    limit = scene.limit("replay_terminal_position_error")
    told = {
        "kind": "unstable_starts",
        "scene": SCENE,
        "pipeline": PIPELINE,
        "seed": seed,
        "starts": rows,
    }
    store(out, "unstable-starts", {**told, "limit": limit.value if limit is not None else 0.0})
    return 0


def _told(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
