"""Grazing: a disc passes another at a depth of 1e-9 m, or misses by as much.

On a straight line the depth is d - (v t)^2/(4 r), with an impulse of (4/3) k d T, T = sqrt(4 r
d)/v: 2e-10 N s. A plan has at most one node inside, h k d. The gradient of the end must be finite
on both sides and agree with differences.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.codegen.kernel import Kernel, load_kernel
from models.scenes.two_discs import RADIUS
from validate.stress.case import Found, StressCase, at_most, finding, unlimited
from validate.stress.motion import of_truth
from validate.truth.problems import TruthProblem, grazing

DEPTH = 1e-9
SPEED = 1.0
# Differences must stay on one side of the touch, 1e-9 m away; rounding is 1e-16/2e-10.
_DIFFERENCE = 2e-10


def _gradient_error(kernel: Kernel, problem: TruthProblem) -> float:
    """Return the relative error of the adjoint gradient of the end against central differences."""
    start, u = np.array(problem.scene.task.start, dtype=float), problem.plan.u
    weights = np.zeros((2, problem.nodes + 1, 4))
    weights[:, -1, 3] = 1.0

    def _end(x: np.ndarray) -> float:
        plan = kernel.rollout(x, u, problem.step)
        return float(plan.q[-1, 3] + plan.v[-1, 3])

    _, exact = kernel.adjoint(kernel.rollout(start, u, problem.step), u, weights[0], weights[1])
    differences = np.array(
        [(_end(start + d) - _end(start - d)) / (2.0 * _DIFFERENCE) for d in _DIFFERENCE * np.eye(8)]
    )
    return float(np.abs(exact - differences).max() / np.abs(exact).max())


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("two_discs")
    kernel, problems = load_kernel(scene), (grazing(DEPTH), grazing(-DEPTH))
    k, h = float(kernel.stiffness()[0]), problems[0].step
    plans, replays = zip(*(of_truth(problem, scene) for problem in problems), strict=True)
    impulses = [float(plan.lam.sum()) * h for plan in plans]
    real = [
        math.nan
        if item.contact_impulse is None or not item.ok
        else float(item.contact_impulse[-1].sum())
        for item in replays
    ]
    exact = 4.0 / 3.0 * k * DEPTH * math.sqrt(4.0 * RADIUS * DEPTH) / SPEED
    errors = [_gradient_error(kernel, problem) for problem in problems]
    limit = "with rounding of 1e-16 over differences of 2e-10"
    return finding(
        f"The touch gives {impulses[0]:.1e} N s on the plan's grid, {real[0]:.1e} N s in the replay (exactly {exact:.1e}); the miss gives nothing. "
        f"Gradients agree with differences to {max(errors):.0e} on both sides.",
        at_most(
            "impulse of the touch on the plan's grid",
            impulses[0],
            1.001 * h * k * DEPTH,
            "N s",
            reason="one node, h k d",
        ),
        at_most(
            "impulse of the miss on the plan's grid",
            abs(impulses[1]),
            0.0,
            "N s",
            reason="nothing is touched",
        ),
        at_most(
            "impulse of the touch in the replay",
            abs(real[0]),
            1.01 * exact,
            "N s",
            reason="that of the straight passage",
        ),
        at_most(
            "impulse of the miss in the replay",
            abs(real[1]),
            0.0,
            "N s",
            reason="nothing is touched",
        ),
        at_most("gradient, just touching: relative error", errors[0], 1e-5, reason=limit),
        at_most("gradient, just missing: relative error", errors[1], 1e-5, reason=limit),
        unlimited("impulse of the straight passage, in closed form", exact, "N s"),
    )


CASE = StressCase(
    title="Grazing contact, depth 1e-9 m",
    expected="No spurious impulse, and a finite gradient on both sides that agrees with differences.",
    scenes=("two_discs",),
    quick=True,
)
