"""Contact creates energy although the step is stable: restitution of one collision over h w, in 100 phases of the first touch within a step.

Two free masses on a linear spring part as fast as they met: restitution 1. The semi-implicit step
keeps that only on the average; what a single collision gives depends on where within a step it
begins. It keeps I = v^2 - h w^2 x v + w^2 x^2 in contact; a touch a share p of a step before the
first node inside has I = s^2 (1 - (h w)^2 p (1 - p)), and so has the parting: restitution lies
between sqrt(1 - (h w)^2/4) and one over that.
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
# h w -> smallest and largest restitution known, and a unit of their last digit: they come from 100
# phases too, but not these (all phases at h w = 1.5 together reach from 0.8 to 1.25).
EXPECTED = {0.1: (0.999, 1.001, 1e-3), 0.6: (0.98, 1.02, 1e-2), 1.5: (0.80, 1.24, 1e-2)}
SWEEP = tuple(np.round(np.linspace(0.05, 1.95, 39), 3))


def _restitutions(kernel: Kernel, hw: float) -> np.ndarray:
    """(PHASES,) restitution of one collision at h w, each with its own place of the first touch within a step."""
    values = {parameter.name: parameter.value for parameter in kernel.scene.parameters}
    m1, m2, k, r = (values[name] for name in ("m1", "m2", "k", "r"))
    w = math.sqrt(k * (m1 + m2) / (m1 * m2))
    h, closing = hw / w, 3.0
    steps = math.ceil(3.0 * math.pi / hw) + 10
    found = []
    for phase in (np.arange(PHASES) + 0.5) / PHASES:
        start = np.array([0.0, 2.0 * r + closing * h * (2.0 + phase), 2.0, 2.0 - closing])
        v = kernel.rollout(start, np.zeros((steps, 0)), h).v
        found.append((v[-1, 1] - v[-1, 0]) / closing)
    return np.array(found)


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("two_body_collision")
    kernel = load_kernel(scene)
    figures = []
    for hw, (low, high, digit) in EXPECTED.items():
        found = _restitutions(kernel, hw)
        off = max(abs(found.min() - low), abs(found.max() - high))
        figures.append(
            at_most(
                f"restitution at h w = {hw:g}: {found.min():.4g} to {found.max():.4g}, off the known {low:g} to {high:g} by",
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
        max(found.max() / most, 1.0 / (found.min() * most))
        for found, most in zip(swept, bound, strict=True)
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
                    "largest": (SWEEP, [found.max() for found in swept]),
                    "mean": (SWEEP, [found.mean() for found in swept]),
                    "smallest": (SWEEP, [found.min() for found in swept]),
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
