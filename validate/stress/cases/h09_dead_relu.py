"""Dead ReLU: only the middle cart has a goal, and at the first guess nothing touches it: no gradient. Said in words, and escaped by smoothing."""

from __future__ import annotations

import math

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.scene import Scene
from models.trajectory import Trajectory
from validate.stress.case import Found, StressCase, at_most, finding, none_of, unlimited

GOAL = 3.3
SOFTPLUS_EPS = (1e-2, 1e-3, 1e-5)


def _run(scene: Scene, method: str, eps: float | None, plan: Trajectory | None, iterations: int) -> Solution:
    with load_method(method).open(scene, {"max_iterations": iterations}) as session:
        return session.solve(eps=eps, warm_start=plan, time_limit=15.0)


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart").with_task(goal=(None, GOAL, None, None, 0.0, None))
    dead = _run(scene, "relu_gd", None, None, 500)
    plan, relaxed = None, None
    for eps in SOFTPLUS_EPS:
        relaxed = _run(scene, "softplus_gd", eps, plan, 400)
        plan = relaxed.trajectory or plan
    alive = _run(scene, "relu_gd", None, plan, 2000)
    words = []
    if dead.outcome is Outcome.SOLVED:
        words.append("the dead descent calls it solved")
    words += [f"no word of {word!r}" for word in ("no contact is made", "no gradient", "softplus") if word not in dead.message]
    missed = alive.residuals.get("terminal_position_error", math.inf)
    before = dead.residuals.get("terminal_position_error", math.nan)
    return finding(
        f"From the first guess: {dead.outcome.name.lower()}, {dead.message} Through softplus: the middle cart misses by {missed:.3f} m instead of {before:.3f} m.",
        none_of(
            "what the diagnosis lacks", words, reason="the message says that no contact is made, that there is no gradient, and what helps"
        ),
        at_most("terminal position error after smoothing", missed, 0.05, "m", reason="the largest miss the paper calls successful"),
        unlimited("cost after smoothing", math.nan if alive.cost is None else alive.cost),
        unlimited("terminal position error without", before, "m"),
    )


CASE = StressCase(
    title="Dead ReLU: no contact at the first guess",
    expected="Diagnosed in words, and escaped by smoothing.",
    scenes=("three_cart",),
    methods=("relu_gd", "softplus_gd"),
)
