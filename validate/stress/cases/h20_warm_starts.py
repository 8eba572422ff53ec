"""Warm starts that cannot be meant: not a number, another length, another scene.

Each is refused in one sentence that names the field.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from models.catalog import load_scene
from models.trajectory import Trajectory
from validate.stress.case import Found, StressCase, finding, none_of, refusal, unlimited
from validate.stress.motion import rolled, solved

METHODS = {
    "softplus_dc": 1e-3,
    "relaxed_lcp": 1e-2,
    "strict_lcp": None,
    "mpcc": None,
    "softplus_gd": 1e-3,
    "relu_gd": None,
}
STEPS = 50


def _spoiled(plan: Trajectory, field: str, value: float) -> Trajectory:
    array = np.array(getattr(plan, field))
    array[3, 0] = value
    return replace(plan, **{field: array})


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart").with_task(steps=STEPS)
    good = rolled(scene)
    found: list[list[str]] = []
    for field in ("t", "q", "v", "u", "lam"):
        for what, value in (("NaN", np.nan), ("infinity", np.inf)) if field != "t" else ():
            found.append(
                refusal(
                    f"{what} in {field}", [f"{field}[3, 0]"], partial(_spoiled, good, field, value)
                )
            )
        short, word = {field: getattr(good, field)[:-1]}, "rows" if field != "t" else "q has shape"
        found.append(refusal(f"too short a {field}", [word], partial(replace, good, **short)))
    other_length, other_scene = (
        rolled(scene, steps=STEPS + 7),
        rolled(load_scene("cart_pole_walls"), step=scene.task.step, steps=STEPS),
    )
    for name, eps in METHODS.items():
        for what, word, plan in (
            ("another length", "steps", other_length),
            ("another scene", "columns", other_scene),
        ):
            found.append(
                refusal(
                    f"{name}, {what}", [word], partial(solved, scene, name, eps, plan, seconds=5.0)
                )
            )
    wrong = [sentence for sentences in found for sentence in sentences]
    refused = sum(not sentences for sentences in found)
    return finding(
        f"{refused} bad warm starts refused, by the plan itself or by {len(METHODS)} methods.",
        none_of("taken, or refused without naming the field", wrong, reason="a sentence each"),
        unlimited("refused", refused),
    )


CASE = StressCase(
    title="Warm start with NaN, wrong length, other scene",
    expected="Refused, naming the field.",
    scenes=("three_cart", "cart_pole_walls"),
    methods=("softplus_dc", "relaxed_lcp", "strict_lcp", "mpcc", "softplus_gd", "relu_gd"),
)
