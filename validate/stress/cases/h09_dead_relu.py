"""Dead ReLU: no contact at the first guess gives no gradient; smoothing solves this."""

from __future__ import annotations

import math

from formulations.solution import Outcome
from models.catalog import load_scene
from validate.stress.case import Found, StressCase, at_most, finding, none_of, unlimited
from validate.stress.motion import solved

GOAL = 3.3
SOFTPLUS_EPS = (1e-2, 1e-3, 1e-5)
_ENOUGH = 15.0  # seconds per descent


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("three_cart").with_task(goal=(None, GOAL, None, None, 0.0, None))
    dead, plan = solved(scene, "relu_gd", seconds=_ENOUGH, max_iterations=500), None
    for eps in SOFTPLUS_EPS:
        plan = (
            solved(scene, "softplus_gd", eps, plan, seconds=_ENOUGH, max_iterations=400).trajectory
            or plan
        )
    alive = solved(scene, "relu_gd", None, plan, seconds=_ENOUGH, max_iterations=2000)
    words = []
    if dead.outcome is Outcome.SOLVED:
        words.append("the dead descent calls it solved")
    words += [
        f"no word of {word!r}"
        for word in ("no contact is made", "no gradient", "softplus")
        if word not in dead.message
    ]
    missed = alive.residuals.get("terminal_position_error", math.inf)
    before = dead.residuals.get("terminal_position_error", math.nan)
    return finding(
        f"From the first guess: {dead.outcome.name.lower()}, {dead.message} Through softplus: the middle cart misses by {missed:.3f} m instead of {before:.3f} m.",
        none_of(
            "what the diagnosis lacks",
            words,
            reason="the message says that no contact is made, that there is no gradient, and what helps",
        ),
        at_most(
            "terminal position error after smoothing",
            missed,
            0.05,
            "m",
            reason="the largest miss the paper calls successful",
        ),
        unlimited("cost after smoothing", math.nan if alive.cost is None else alive.cost),
        unlimited("terminal position error without", before, "m"),
    )


CASE = StressCase(
    title="Dead ReLU: no contact at the first guess",
    expected="Diagnosed in words, and escaped by smoothing.",
    scenes=("three_cart",),
    methods=("relu_gd", "softplus_gd"),
)
