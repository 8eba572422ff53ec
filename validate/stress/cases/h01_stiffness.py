"""Stiffness from 1 to 1e8 N/m at a fixed step: a warning past the stability limit.

Three carts at h = 0.01 s: h^2 w^2 + 2 h c < 4 with w^2 = 3k and c = 2 allows k < 13200. Accuracy is
measured on two colliding bodies with a known motion (validate.truth): at the fixed step, at a fine
step, and by the replay.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.scenes import two_body_collision as pair
from models.stability import step_stability
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
from validate.stress.motion import of_truth, rolled, wrong_by
from validate.truth.problems import contact_rate, stiff

STIFFNESSES = tuple(10.0**power for power in range(9))
# Points of the plot around the limit.
SWEPT = 7

STEP = 0.01
DAMPING = 2.0
LIMIT = (4.0 - 2.0 * STEP * DAMPING) / (3.0 * STEP**2)
# Fine steps per radian of the contact's oscillation; a collision has 150.
_FINE = 50
# Largest error of the speed after a collision, over (h w)^2, of a first-order step (h02).
_RESTITUTION = 0.1
# Largest error to plot.
_FAR = 1e6


def measure() -> Found:
    """Measure the case."""
    base, like = load_scene("three_cart"), stiff(STIFFNESSES[0]).scene
    radii, coarse, fine, shares, replays, unwarned = [], [], [], [], [], []
    for k in STIFFNESSES:
        stability = step_stability(base.with_parameters(k=k))
        radii.append(stability.radius)
        if bool(stability.sentence) != (k > LIMIT):
            unwarned.append(f"k = {k:g}: {stability.sentence or 'no warning'}")
        problem = stiff(k)
        plan, motion_by_replay = of_truth(problem, like)
        rate = contact_rate(pair.MASS_1, pair.MASS_2, k)
        parts = max(1, math.ceil(problem.step * _FINE * rate))
        h = problem.step / parts
        exact = rolled(problem.scene, step=h, steps=problem.nodes * parts, every=parts)
        errors = [wrong_by(problem, motion) for motion in (plan, exact, motion_by_replay)]
        for errors_by_k, error in zip((coarse, fine, replays), errors, strict=True):
            errors_by_k.append(max(error.values()))
        drift = (
            problem.velocity * h
            + _RESTITUTION * (h * rate) ** 2 * problem.velocity * problem.duration
        )
        shares.append(errors[1]["position at the end"] * problem.position / drift)
    below, above = (
        step_stability(base.with_parameters(k=LIMIT * factor)) for factor in (0.9999, 1.0001)
    )
    near = np.geomspace(LIMIT / 10, LIMIT * 10, SWEPT)
    swept = [(k, step_stability(base.with_parameters(k=float(k))).radius) for k in near]
    curve = sorted([*zip(STIFFNESSES, radii, strict=True), *swept])
    return finding(
        f"The warning comes from k = {LIMIT:.0f} N/m on, before anything runs. At the fixed step a collision is wrong by {coarse[0]:.1e} for k = {STIFFNESSES[0]:g} "
        f"and {coarse[-1]:.0e} for k = {STIFFNESSES[-1]:g}; with {_FINE} steps a radian of the contact by at most {max(fine):.1e}, in the replay {max(replays):.0e}.",
        at_most(
            "spectral radius at 0.9999 of the limit",
            below.radius,
            1.0 + 1e-6,
            reason="inside the limit nothing grows but for rounding",
        ),
        at_least(
            "spectral radius at 1.0001 of the limit",
            above.radius,
            1.0 + 1e-4,
            reason="past it a closed contact grows",
        ),
        none_of(
            "stiffnesses warned of wrongly or not at all",
            unwarned,
            reason=f"exactly those past {LIMIT:.0f} N/m",
        ),
        at_most(
            "error with the smaller step, share of what a first-order step may be wrong by",
            max(shares),
            1.0,
            reason="v h of drift, and a tenth of (h w)^2 of the speed after the collision, over the time that is compared",
        ),
        at_most(
            "largest error of the replay",
            max(replays),
            1e-7,
            reason="as of our reference on every problem of the truth suite",
        ),
        unlimited(
            "largest error at the fixed step inside the limit",
            max(error for k, error in zip(STIFFNESSES, coarse, strict=True) if k < LIMIT),
        ),
        unlimited(f"error at the fixed step, k = {STIFFNESSES[-1]:g} N/m", coarse[-1]),
        charts=(
            chart(
                "Spectral radius of the step with all contacts closed",
                x=("stiffness k", "N/m"),
                y=("spectral radius", ""),
                series={"h = 0.01 s": ([k for k, _ in curve], [radius for _, radius in curve])},
                log="xy",
                level=(1.0, "stability limit"),
                words=f"At 1 up to k = {LIMIT:.0f} N/m, and rising with k beyond.",
            ),
            chart(
                "Error of one collision against its closed form",
                x=("stiffness k", "N/m"),
                y=("error", ""),
                series={
                    "h = 4 ms": (STIFFNESSES, [min(error, _FAR) for error in coarse]),
                    f"{_FINE} steps a radian of the contact": (STIFFNESSES, fine),
                    "the replay": (STIFFNESSES, replays),
                },
                log="xy",
                words="Past the limit the fixed step throws the bodies away (beyond 1e6 it is drawn there); the smaller step stays right at every stiffness.",
            ),
        ),
    )


CASE = StressCase(
    title="Stiffness k = 1 .. 1e8 at a fixed step",
    expected="Warns before the run past the stability limit of semi-implicit Euler, h²ω² + 2hc < 4, and is still right with a smaller step.",
    scenes=("three_cart", "two_body_collision"),
    quick=True,
)
