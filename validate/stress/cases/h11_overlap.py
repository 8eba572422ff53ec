"""Penetration at the start, down to coincident centres with an undefined normal: all finite."""

from __future__ import annotations

import numpy as np

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from validate.stress.case import Found, StressCase, at_least, finding, none_of
from validate.stress.motion import replayed, rolled

DISTANCES = (0.3, 1e-3, 1e-9, 0.0)
STEPS = 480


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("two_discs")
    kernel = load_kernel(scene)
    h = scene.task.step / 20  # a spring compressed by 0.4 m needs a finer grid than the task's
    wrong, apart = [], {}
    for distance in DISTANCES:
        where = f"centres {distance:g} m apart"
        start = np.array([0.0, 0.0, distance, 0.0, 0.0, 0.0, 0.0, 0.0])
        rollout = kernel.rollout(start, np.zeros((STEPS, 2)), h)
        bar = np.ones_like(rollout.q)
        gradients = kernel.adjoint(rollout, np.zeros((STEPS, 2)), bar, bar)
        if rollout.diverged or not all(
            np.isfinite(array).all() for array in (rollout.q, rollout.v, rollout.lam, *gradients)
        ):
            wrong.append(f"{where}: the plan's step or its gradient is not finite")
            continue
        motion = replayed(scene, rolled(scene, start=start, step=h, steps=STEPS))
        if not motion.ok:
            wrong.append(f"{where}: {motion.message}")
            continue
        apart[distance] = float(np.linalg.norm(motion.q[-1, 2:] - motion.q[-1, :2]))
    pushed = min((value for distance, value in apart.items() if distance > 0.0), default=np.nan)
    return finding(
        f"All finite. Discs that overlap are pushed apart to at least {pushed:.2f} m; coincident centres have no direction between them, "
        f"feel no force along any, and stay ({apart.get(0.0, np.nan):.1g} m).",
        none_of("starts that are not finite", wrong, reason="step, gradient and replay"),
        at_least(
            "distance of the centres after the push, smallest",
            pushed,
            0.4,
            "m",
            reason="two radii: they have parted",
        ),
    )


CASE = StressCase(
    title="Penetration at the start, coincident centres",
    expected="A defined normal and finite values.",
    scenes=("two_discs",),
)
