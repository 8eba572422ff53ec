"""Hold of inputs, and uneven grids.

Sampled smooth inputs converge with order 1 if held, with order 2 if linear. A plan with a short
step moves as on an even grid. A warm start on another grid is refused.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from models.catalog import load_scene
from models.scene import Scene
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.stress.case import (
    Found,
    StressCase,
    at_least,
    at_most,
    chart,
    finding,
    none_of,
    refusal,
)
from validate.stress.motion import replayed, rolled, solved

SECONDS = 0.8
COUNTS = (10, 20, 40, 80)
FINE = 640


def _smooth(t: np.ndarray) -> np.ndarray:
    return np.column_stack([6.0 + 3.0 * np.sin(4.0 * t), -6.0 + 2.0 * np.cos(5.0 * t)])


def _held(scene: Scene, t: np.ndarray, u: np.ndarray, hold: Hold) -> Trajectory:
    """Return a plan of these inputs; a replay uses only its start besides."""
    start = np.array(scene.task.start)
    state = np.tile(start, (len(t), 1))
    return Trajectory(
        t=t,
        q=state[:, : scene.nq],
        v=state[:, scene.nq :],
        u=u,
        lam=np.zeros((len(t) - 1, scene.nl)),
        hold=hold,
    )


def _end_of(scene: Scene, count: int, hold: Hold) -> np.ndarray:
    t = uniform_grid(SECONDS / count, count)
    return replayed(scene, _held(scene, t, _smooth(t[:-1]), hold)).end


def order(errors: list[float]) -> float:
    """Return the slope of log error over log step."""
    return -float(np.polyfit(np.log(COUNTS), np.log(errors), 1)[0])


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("three_cart").with_task(start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0))
    # The last step of a linear plan is constant: an error of order 1 in a shrinking step, order 2.
    truth = _end_of(scene, FINE, Hold.LINEAR)
    errors = {
        hold: [float(np.abs(_end_of(scene, count, hold) - truth).max()) for count in COUNTS]
        for hold in Hold
    }
    orders = {hold: order(values) for hold, values in errors.items()}
    whole = uniform_grid(0.1, 8)
    odd = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.47, 0.5, 0.6, 0.7, 0.8])
    u = _smooth(whole[:-1])
    parts = u[[0, 1, 2, 3, 4, 4, 5, 6, 7]]
    one, other = (
        replayed(scene, _held(scene, t, values, Hold.ZERO_ORDER))
        for t, values in ((whole, u), (odd, parts))
    )
    same = float(np.abs(one.end - other.end).max()) if one.ok and other.ok else math.inf
    wrong = []
    other_grid = rolled(scene, step=0.03, steps=166)  # 4.98 s: another step and horizon
    for name, eps in (("softplus_dc", 1e-3), ("strict_lcp", None), ("mpcc", None)):
        solve = partial(solved, scene, name, eps, other_grid, seconds=5.0)
        wrong += refusal(f"{name}, a warm start on another grid", ["resample", "steps"], solve)
    return finding(
        f"Order {orders[Hold.ZERO_ORDER]:.2f} with held inputs, {orders[Hold.LINEAR]:.2f} with lines; a grid that does not divide ends within {same:.0e} of one that does.",
        at_most(
            "order with held inputs, off 1",
            abs(orders[Hold.ZERO_ORDER] - 1.0),
            0.15,
            reason="inputs wrong by half a step",
        ),
        at_least(
            "order with lines",
            orders[Hold.LINEAR],
            1.8,
            reason="inputs wrong by the square of a step",
        ),
        at_most(
            "a step cut in two parts: difference of the end",
            same,
            1e-9,
            reason="the same inputs; ten times the replay's own error",
        ),
        none_of(
            "warm starts on another grid that are not refused",
            wrong,
            reason="one grid, or a sentence",
        ),
        charts=(
            chart(
                "End of the replay against the number of steps",
                x=("steps", ""),
                y=("error of the end", ""),
                series={
                    hold.value.replace("_", " "): (COUNTS, values)
                    for hold, values in errors.items()
                },
                log="xy",
            ),
        ),
    )


CASE = StressCase(
    title="Hold convention, and time grids that do not divide",
    expected="One convention on both sides of the replay, else refused.",
    scenes=("three_cart",),
    methods=("softplus_dc", "strict_lcp", "mpcc"),
)
