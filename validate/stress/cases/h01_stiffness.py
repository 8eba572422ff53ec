"""Stiffness from 1 to 1e8 N/m at a fixed step: a warning before the run past the stability limit, and the right motion with a smaller step.

Three carts at h = 0.01 s: h^2 w^2 + 2 h c < 4 with w^2 = 3k and c = 2 allows k < 13200. The left cart is driven for 0.3 s, then hits the
middle one, which hits the right one. The everyday grid and one as fine as the contact needs are held against the replay.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.stability import step_stability
from validate.stress.case import Found, StressCase, at_least, at_most, chart, finding, none_of, unlimited
from validate.stress.motion import replayed, rolled

STIFFNESSES = tuple(10.0**power for power in range(9))
# Points of the plot about the limit.
SWEPT = 7
STEP, DAMPING, NODES, PUSHED = 0.01, 2.0, 100, 30
LIMIT = (4.0 - 2.0 * STEP * DAMPING) / (3.0 * STEP**2)
# Steps a radian of the contact's oscillation in the fine grid: 50 of them, so that a collision has 150.
_FINE = 50
# What a first-order step may be wrong by at speed v [m/s]: v h of drift, and after each of two collisions a speed that is wrong by a tenth of (h w)^2 (h02).
_SPEED, _COLLISIONS, _RESTITUTION = 2.0, 2, 0.1
# Where a plan that blew up is drawn [m].
_FAR = 1e6


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    base = load_scene("three_cart")
    u = np.zeros((NODES, 2))
    u[:PUSHED, 0] = 8.0
    radii, coarse, fine, shares, unwarned = [], [], [], [], []
    for k in STIFFNESSES:
        scene = base.with_parameters(k=k)
        said = step_stability(scene)
        radii.append(said.radius)
        if bool(said.sentence) != (k > LIMIT):
            unwarned.append(f"k = {k:g}: {said.sentence or 'no warning'}")
        truth = replayed(scene, rolled(scene, u=u), like=base)
        truth_q = truth.q[truth.knots]
        parts = max(1, math.ceil(STEP * _FINE * math.sqrt(3.0 * k)))
        exact = rolled(scene, u=np.repeat(u, parts, axis=0), step=STEP / parts, every=parts)
        coarse.append(float(np.abs(rolled(scene, u=u).q - truth_q).max()))
        fine.append(float(np.abs(exact.q - truth_q).max()))
        h = STEP / parts
        shares.append(fine[-1] / (_SPEED * h + _COLLISIONS * _RESTITUTION * 3.0 * k * h**2 * _SPEED * STEP * NODES))
    below, above = (step_stability(base.with_parameters(k=LIMIT * factor)) for factor in (0.9999, 1.0001))
    near = np.geomspace(LIMIT / 10, LIMIT * 10, SWEPT)
    swept = [(k, step_stability(base.with_parameters(k=float(k))).radius) for k in near]
    curve = sorted([*zip(STIFFNESSES, radii, strict=True), *swept])
    return finding(
        f"The warning comes from k = {LIMIT:.0f} N/m on, before anything runs. At the fixed step the error is {coarse[0]:.1e} m for k = {STIFFNESSES[0]:g} and "
        f"{coarse[-1]:.0e} m for k = {STIFFNESSES[-1]:g}; with {_FINE} steps a radian of the contact it is at most {max(fine):.1e} m.",
        at_most(
            "spectral radius at 0.9999 of the limit", below.radius, 1.0 + 1e-6, reason="inside the limit nothing grows but for rounding"
        ),
        at_least("spectral radius at 1.0001 of the limit", above.radius, 1.0 + 1e-4, reason="past it a closed contact grows"),
        none_of("stiffnesses warned of wrongly or not at all", unwarned, reason=f"exactly those past {LIMIT:.0f} N/m"),
        at_most(
            "error with the smaller step, share of what a first-order step may be wrong by",
            max(shares),
            1.0,
            reason="v h of drift, and a tenth of (h w)^2 of the speed after each of two collisions, over the second that is compared",
        ),
        unlimited(
            "largest error at the fixed step inside the limit",
            max(error for k, error in zip(STIFFNESSES, coarse, strict=True) if k < LIMIT),
            "m",
        ),
        unlimited(f"error at the fixed step, k = {STIFFNESSES[-1]:g} N/m", coarse[-1], "m"),
        charts=(
            chart(
                "Spectral radius of the step with all contacts closed",
                x=("stiffness k", "N/m"),
                y=("spectral radius", ""),
                series={"h = 0.01 s": ([k for k, _ in curve], [radius for _, radius in curve])},
                log_x=True,
                log_y=True,
                level=(1.0, "stability limit"),
                words=f"At 1 up to k = {LIMIT:.0f} N/m, and rising with k beyond.",
            ),
            chart(
                "Error of the plan's grid against the replay",
                x=("stiffness k", "N/m"),
                y=("largest position error", "m"),
                series={
                    "h = 0.01 s": (STIFFNESSES, [min(error, _FAR) for error in coarse]),
                    f"{_FINE} steps a radian of the contact": (STIFFNESSES, fine),
                },
                log_x=True,
                log_y=True,
                words="Past the limit the fixed step throws the carts away (beyond 1000 km it is drawn there); the smaller step stays right at every stiffness.",
            ),
        ),
    )


CASE = StressCase(
    title="Stiffness k = 1 .. 1e8 at a fixed step",
    expected="Warns before the run past the stability limit of semi-implicit Euler, h²ω² + 2hc < 4, and is still right with a smaller step.",
    scenes=("three_cart",),
    quick=True,
)
