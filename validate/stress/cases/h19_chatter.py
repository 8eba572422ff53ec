"""Chattering plan: both carts reverse at their bounds in each step, pressing the middle one.

The replay must converge as its step shrinks, or be undecided.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from models.catalog import load_scene
from validate.judge.score import Verdict, score
from validate.stress.case import Found, StressCase, at_least, at_most, finding, none_of, unlimited
from validate.stress.motion import replayed, rolled

NODES = 300
# Internal steps per plan step; the default ones leave only rounding.
COARSE = (5, 10, 20)


def measure() -> Found:
    """Measure the case."""
    base = load_scene("three_cart")
    # The carts always touch; each reversal is a collision.
    scene = base.with_parameters(k=3000.0).with_task(
        start=(2.0, 2.51, 3.02, 0.0, 0.0, 0.0), steps=NODES
    )
    swing = np.where(np.arange(NODES) % 2 == 0, 10.0, -10.0)[:, None]
    u = np.clip(swing * [1.0, -1.0] + [3.0, -3.0], -10.0, 10.0)
    plan = rolled(scene, u=u)
    result = replayed(scene, plan, like=base)
    verdict = score(scene, plan, result).verdict
    coarse, error = (
        replayed(scene, plan, like=base, fineness=pair).error for pair in pairwise(COARSE)
    )
    ratio = math.nan
    if coarse.step is not None and error.step is not None and error.step.position > 0.0:
        ratio = coarse.step.position / error.step.position
    converges = result.ok and ratio >= 1.5
    estimate = math.nan if result.error.estimate is None else result.error.estimate.position
    silent = (
        []
        if converges or verdict is Verdict.UNDECIDED
        else [f"ratio {ratio:.2f} and yet {verdict.value}"]
    )
    far = (
        error.everyday.position / max(error.step.position, 1e-12)
        if result.ok and error.everyday and error.step
        else math.nan
    )
    return finding(
        f"{len(result.events)} contact events in {NODES} steps; the everyday replay's differences shrink by {ratio:.2f} as its step is halved, and the "
        f"reference knows itself to {estimate:.0e} m.",
        none_of("neither converging nor marked `undecided`", silent, reason="one of the two"),
        at_least(
            "ratio of the differences when the step is halved",
            ratio,
            1.5,
            reason="2 for an event within a step, 4 and more where none is",
        ),
        at_most(
            "everyday replay against the reference, in its own step differences",
            far,
            3.0,
            reason="what the replay calls explained by its step",
        ),
        unlimited("contact events", len(result.events)),
    )


CASE = StressCase(
    title="Chattering plan (bang-bang inputs)",
    expected="The replay converges as the step shrinks, or is marked `undecided`.",
    scenes=("three_cart",),
)
