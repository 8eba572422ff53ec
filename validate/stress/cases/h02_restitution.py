"""Restitution of one collision over h w, in 100 phases: stable steps can create energy.

Two masses on a linear spring have restitution 1, semi-implicit Euler only on average. In contact it
keeps I = v^2 - h w^2 x v + w^2 x^2. A touch a fraction p of a step before the first node inside has
I = s^2 (1 - (h w)^2 p (1 - p)), and so has the parting. Restitution is therefore between sqrt(1 -
(h w)^2/4) and its inverse.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.codegen.kernel import Kernel, load_kernel
from validate.judge.score import score
from validate.stress.case import Found, StressCase, at_most, chart, finding
from validate.stress.motion import replayed, rolled

PHASES = 100
# Smallest and largest known restitution by h w, and a unit of their last digit, from 100 other
# phases; all phases at h w = 1.5 give 0.8 to 1.25.
EXPECTED = {0.1: (0.999, 1.001, 1e-3), 0.6: (0.98, 1.02, 1e-2), 1.5: (0.80, 1.24, 1e-2)}
# Values of h w.
SWEEP = tuple(np.round(np.linspace(0.05, 1.95, 39), 3))


def _restitutions(kernel: Kernel, hw: float) -> np.ndarray:
    """Return the restitutions (PHASES,) at h w, by phase of the first touch within a step."""
    values = {parameter.name: parameter.value for parameter in kernel.scene.parameters}
    m1, m2, k, r = (values[name] for name in ("m1", "m2", "k", "r"))
    w = math.sqrt(k * (m1 + m2) / (m1 * m2))
    h, closing = hw / w, 3.0
    steps = math.ceil(3.0 * math.pi / hw) + 10
    restitutions = []
    for phase in (np.arange(PHASES) + 0.5) / PHASES:
        start = np.array([0.0, 2.0 * r + closing * h * (2.0 + phase), 2.0, 2.0 - closing])
        v = kernel.rollout(start, np.zeros((steps, 0)), h).v
        restitutions.append((v[-1, 1] - v[-1, 0]) / closing)
    return np.array(restitutions)


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("two_body_collision")
    kernel = load_kernel(scene)
    figures = []
    for hw, (low, high, digit) in EXPECTED.items():
        restitutions = _restitutions(kernel, hw)
        off = max(abs(restitutions.min() - low), abs(restitutions.max() - high))
        figures.append(
            at_most(
                f"restitution at h w = {hw:g}: {restitutions.min():.4g} to {restitutions.max():.4g}, off the known {low:g} to {high:g} by",
                off,
                digit,
                reason="a unit of the last known digit: which phases are tried moves it by as much",
            )
        )
    exact = np.abs(_restitutions(kernel, 1.0) - 1.0).max()
    plan = rolled(scene)
    answer = score(scene, plan, replayed(scene, plan)).value("answer_error")
    value = math.nan if answer is None else answer
    swept = [_restitutions(kernel, hw) for hw in SWEEP]
    bound = [1.0 / math.sqrt(1.0 - hw**2 / 4.0) for hw in SWEEP]
    outside = max(
        max(restitutions.max() / most, 1.0 / (restitutions.min() * most))
        for restitutions, most in zip(swept, bound, strict=True)
    )
    worst = _restitutions(kernel, 1.5)
    return finding(
        f"At h w = 1.5, well inside the stability limit of 2, one collision gives between {worst.min():.2f} and {worst.max():.2f} of the speed back; "
        "the replay gives 1.",
        *figures,
        at_most(
            "restitution - 1 at h w = 1, any phase",
            exact,
            1e-9,
            reason="six steps are a period there: the collision is exact",
        ),
        at_most(
            "the replay, in tolerances of the closed forms",
            value,
            1.0,
            reason="restitution 1, contact time and depth to 1e-9 each",
        ),
        at_most(
            "largest restitution (or 1/smallest) over the bound 1/sqrt(1 - (h w)^2/4)",
            outside,
            1.0 + 1e-9,
            reason="see the case's file",
        ),
        charts=(
            chart(
                f"Restitution of one collision, {PHASES} phases",
                x=("h w", ""),
                y=("restitution", ""),
                series={
                    "largest": (SWEEP, [restitutions.max() for restitutions in swept]),
                    "mean": (SWEEP, [restitutions.mean() for restitutions in swept]),
                    "smallest": (SWEEP, [restitutions.min() for restitutions in swept]),
                },
                level=(1.0, "exact"),
                words="The spread grows with h w, vanishes at 1 and 1.41, where a period is a whole number of steps, and runs away towards the stability limit at 2.",
            ),
        ),
    )


CASE = StressCase(
    title="Restitution inside the stability limit",
    expected="Contact creates energy while the step is stable: restitution 0.999 to 1.001 at hω = 0.1, 0.98 to 1.02 at 0.6, 0.80 to 1.24 at 1.5, "
    "exactly 1 at 1. The replay keeps it at 1.",
    scenes=("two_body_collision",),
    quick=True,
)
