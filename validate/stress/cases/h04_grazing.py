"""Grazing: a disc passes another so that they touch to a depth of 1e-9 m, or miss by as much.

Pushed straight past, the depth is d - (v t)^2/(4 r): the impulse is (4/3) k d T with T = sqrt(4 r d)/v, 2e-10 N s here. The plan's own step sees one
node inside and gives at most h k d. The gradient of the end is finite on both sides, and that of differences.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from models.scenes.two_discs import BLUR, RADIUS
from validate.stress.case import Found, StressCase, at_most, finding, unlimited
from validate.stress.motion import replayed, rolled

DEPTH, SPEED, NODES, BEFORE = 1e-9, 1.0, 200, 100
# Differences must stay on one side of the touch, which is 1e-9 m away; their rounding is then 1e-16/2e-10 of the state.
_DIFFERENCE = 2e-10


def _passing(scene: Scene, depth: float, speed: float = SPEED) -> np.ndarray:
    """Start (8,) of disc 1 moving along x past disc 2, at rest in the origin; a node lies exactly where they are nearest."""
    height = math.sqrt((2.0 * RADIUS - depth) ** 2 - BLUR**2)
    return np.array([-BEFORE * scene.task.step * speed, height, 0.0, 0.0, speed, 0.0, 0.0, 0.0])


def _gradient_error(kernel: Kernel, start: np.ndarray) -> float:
    """Adjoint against central differences: derivative of the end (y of disc 2 and its speed) with respect to the start, relative to its largest."""
    scene, u = kernel.scene, np.zeros((NODES, 2))
    weights = np.zeros((2, NODES + 1, 4))
    weights[:, -1, 3] = 1.0

    def _end(x: np.ndarray) -> float:
        plan = kernel.rollout(x, u, scene.task.step)
        return float(plan.q[-1, 3] + plan.v[-1, 3])

    _, exact = kernel.adjoint(kernel.rollout(start, u, scene.task.step), u, weights[0], weights[1])
    differences = np.array([(_end(start + d) - _end(start - d)) / (2.0 * _DIFFERENCE) for d in _DIFFERENCE * np.eye(8)])
    return float(np.abs(exact - differences).max() / np.abs(exact).max())


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("two_discs")
    kernel, h = load_kernel(scene), scene.task.step
    k = float(kernel.stiffness()[0])
    touching, missing = _passing(scene, DEPTH), _passing(scene, -DEPTH)
    plans = [rolled(scene, start=start, steps=NODES) for start in (touching, missing)]
    impulses = [float(plan.lam.sum()) * h for plan in plans]
    replays = [replayed(scene, plan) for plan in plans]
    real = [math.nan if item.contact_impulse is None or not item.ok else float(item.contact_impulse[-1].sum()) for item in replays]
    exact = 4.0 / 3.0 * k * DEPTH * math.sqrt(4.0 * RADIUS * DEPTH) / SPEED
    errors = [_gradient_error(kernel, start) for start in (touching, missing)]
    limit = "with rounding of 1e-16 over differences of 2e-10"
    return finding(
        f"The touch gives {impulses[0]:.1e} N s on the plan's grid, {real[0]:.1e} N s in the replay (exactly {exact:.1e}); the miss gives nothing. "
        f"Gradients agree with differences to {max(errors):.0e} on both sides.",
        at_most("impulse of the touch on the plan's grid", impulses[0], 1.001 * h * k * DEPTH, "N s", reason="one node, h k d"),
        at_most("impulse of the miss on the plan's grid", abs(impulses[1]), 0.0, "N s", reason="nothing is touched"),
        at_most("impulse of the touch in the replay", abs(real[0]), 1.01 * exact, "N s", reason="that of the straight passage"),
        at_most("impulse of the miss in the replay", abs(real[1]), 0.0, "N s", reason="nothing is touched"),
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
