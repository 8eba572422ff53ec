"""Seeded starts for a homotopy: rollouts of random inputs, the same on every machine."""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid

_PIECES = 10  # of constant input over the horizon
_SHARE, _UNBOUNDED = 0.3, 1.0  # part of the bounds that is used [1], and what stands for a missing bound [N, N m]


def random_plan(scene: Scene, kernel: Kernel, seed: tuple[int, ...]) -> Trajectory | None:
    """Piecewise constant random inputs through softplus contact at eps = 1e-3; None where the rollout diverges."""
    random, task = np.random.default_rng(seed), scene.task
    lower = np.array([max(item.lower, -_UNBOUNDED / _SHARE) if np.isinf(item.lower) else item.lower for item in scene.inputs])
    upper = np.array([min(item.upper, _UNBOUNDED / _SHARE) if np.isinf(item.upper) else item.upper for item in scene.inputs])
    pieces = 0.5 * (lower + upper) + _SHARE * 0.5 * (upper - lower) * random.uniform(-1.0, 1.0, (_PIECES, scene.nu))
    u = pieces[np.arange(task.steps) * _PIECES // task.steps]
    rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, 1e-3)
    if rollout.diverged:
        return None
    return Trajectory(t=uniform_grid(task.step, task.steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam)
