"""Unstable open loop: the cart-pole over 5 s, where errors grow as exp(3.67 t), 9e7 times.

Measured by the Jacobians of the compiled steps, by two replays 1e-6 rad apart, and by gradient
descent, which must report its failure.
"""

from __future__ import annotations

import math

import numpy as np

from formulations.shooting.stage import measure_growth
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scenes.cart_pole_walls import GROWTH
from validate.stress.case import (
    Found,
    StressCase,
    at_least,
    at_most,
    chart,
    finding,
    none_of,
    unlimited,
)
from validate.stress.motion import at_nodes, replayed, rolled, solved

SECONDS = 5.0
NUDGE = 1e-6
ITERATIONS = 60
# Angle up to which the pole is linear [rad], reached after 2.5 s.
_LINEAR = 1e-2


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("cart_pole_walls")
    h = scene.task.step
    steps = round(SECONDS / h)
    upright = scene.with_task(start=(0.0,) * 4, steps=steps)
    still = np.zeros((steps + 1, 4))
    growth = measure_growth(load_steps(upright), still, np.zeros((steps, 1)), ContactLaw.RELU, None)
    if growth is None:
        return finding(
            "A step is not finite: nothing can be said of its growth.",
            unlimited("growth", math.nan),
        )
    rate = growth.rate
    nudged = upright.with_task(start=(0.0, NUDGE, 0.0, 0.0))
    one, other = (replayed(item, rolled(item)) for item in (upright, nudged))
    apart = np.abs(at_nodes(other) - at_nodes(one))[:, 1]
    t = h * np.arange(len(apart))
    linear = (apart > 10 * NUDGE) & (apart < _LINEAR)
    replay_rate = float(np.polyfit(t[linear], np.log(apart[linear]), 1)[0])
    solution = solved(
        scene.with_task(steps=steps), "relu_gd", seconds=10.0, max_iterations=ITERATIONS
    )
    silent = []
    if solution.outcome is Outcome.SOLVED:
        silent.append("descent calls it solved")
    if (
        solution.outcome in (Outcome.DIVERGED, Outcome.EVALUATION_ERROR)
        and solution.trajectory is not None
    ):
        silent.append("a plan came with a descent that diverged")
    if not growth.sentence():
        silent.append("the growth is not told")
    if not solution.message:
        silent.append("descent ended without a word")
    return finding(
        f"An error of the start grows {growth.factor:.1e} times over {SECONDS:g} s by the exact Jacobians of its steps, at {rate:.3f}/s; two replays {NUDGE:g} rad apart part at "
        f"{replay_rate:.3f}/s and are {apart.max():.2g} rad apart in the end. Descent: {solution.outcome.name.lower()}, {solution.message.partition('; ')[0]}.",
        at_most(
            "growth rate of the gradient, off the known one",
            abs(rate / GROWTH - 1.0),
            0.02,
            reason="the step's own (rate h)/2, 3.7 %, halved by its symmetry",
        ),
        at_most(
            "growth rate of the replay, off the known one",
            abs(replay_rate / GROWTH - 1.0),
            0.02,
            reason="linear up to 0.01 rad, but for what decays at first",
        ),
        at_least(
            "growth of an error over the horizon",
            growth.factor,
            1e7,
            reason="exp(3.67/s 5 s) is 9e7",
        ),
        none_of(
            "what descent kept silent about", silent, reason="it must end in words, not in `solved`"
        ),
        unlimited("distance of the two replays in the end", float(apart[-1]), "rad"),
        unlimited(
            "gradient norm where descent began",
            float(next(iter(solution.history.get("gradient_norm", (math.nan,))))),
            "1",
        ),
        charts=(
            chart(
                "Growth of an error of the start",
                x=("time", "s"),
                y=("factor", ""),
                series={
                    "gradient, by the Jacobians of the steps": (t, np.exp(growth.exponents[::-1])),
                    "two replays 1e-6 rad apart": (t[1:], apart[1:] / NUDGE),
                    "exp(3.67 t)": ([0.0, SECONDS], [1.0, math.exp(GROWTH * SECONDS)]),
                },
                log="y",
                words="The replays part along the same line until the pole falls into a wall.",
            ),
        ),
    )


CASE = StressCase(
    title="Unstable open loop: cart-pole, 5 s",
    expected="Growth e^(rate T) is detected and reported, descent does not diverge silently, and a replay nudged by 1e-6 is shown.",
    scenes=("cart_pole_walls",),
    methods=("relu_gd",),
)
