"""Gradient descent through true contact: one whole iteration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validate.bench.carts import INPUT_WEIGHT, push, scene_of
from validate.bench.case import Size, Work

# Iterations of one call; the rate is so small that none of them leaves the plan it starts from.
_ITERATIONS, _RATE = 100, 1e-9


def gd_iteration(size: Size, folder: Path) -> Work:
    """Loss, gradient, history, stopping rule, step and projection on the bounds, as the methods of single shooting run it."""
    from formulations.shooting.descent import descend
    from formulations.shooting.method import DescentOptions
    from formulations.shooting.objective import Objective
    from models.codegen.kernel import load_kernel
    from models.contact_law import ContactLaw
    from validate.bench.measure import cpu_seconds

    objective = Objective(load_kernel(scene_of(size)), law=ContactLaw.RELU)
    u, options = push(size.steps), DescentOptions(learning_rate=_RATE, iterations=_ITERATIONS)
    descend(objective, u, DescentOptions(learning_rate=_RATE, iterations=2), 1e5)

    def work() -> Mapping[str, Any]:
        began = cpu_seconds()
        descent = descend(objective, u, options, 1e5)
        return {"cpu_s": (cpu_seconds() - began) / _ITERATIONS, "iterations": _ITERATIONS, "value": descent.history["gradient_norm"][0]}

    return work


def gd_kernel(size: Size, folder: Path) -> Work:
    """The compiled part of an iteration: rollout and adjoint."""
    import numpy as np

    from models.codegen.kernel import load_kernel

    scene, u = scene_of(size), push(size.steps)
    kernel, start = load_kernel(scene), np.array(scene.task.start)

    def work() -> Mapping[str, Any]:
        plan = kernel.rollout(start, u, scene.task.step)
        kernel.adjoint(plan, u, end_bar=start, cost_bar=INPUT_WEIGHT)
        return {"value": float(plan.q[-1, 0])}

    return work
