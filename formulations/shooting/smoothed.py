"""The loss averaged over random inputs: contact that only some samples make still has a gradient.

    objective = Objective(kernel, law=ContactLaw.RELU, noise=noise(scene, deviation=1.0, samples=16, pieces=5, seed=0))

F(u) = mean over i of loss(u + w_i), with rollouts through the true contact law and first-order gradients, averaged ("bundled": Suh, Pang,
Tedrake, Bundled Gradients through Contact via Randomized Smoothing, RA-L 2022). The w_i are drawn once, in pairs w and -w, and are the
same in every evaluation: F is one function, its minimisation deterministic, and its curvature can be learned. Each w_i is held over a
piece of the horizon, because noise that changes with every step averages out before it moves a body.
"""

from __future__ import annotations

import numpy as np

from models.scene import Scene


def noise(scene: Scene, *, deviation: float, unbounded: float, samples: int, pieces: int, seed: int) -> np.ndarray:
    """w (samples, steps, nu): Gaussian, of standard deviation `deviation` times half the range of each input, or times `unbounded` where it has none.

    samples: even; pieces: so many values over the horizon.
    """
    steps = scene.task.steps
    half = [(item.upper - item.lower) / 2 for item in scene.inputs]
    scale = deviation * np.array([size if np.isfinite(size) else unbounded for size in half])
    values = np.random.default_rng(seed).normal(size=(samples // 2, min(pieces, steps), scene.nu))
    held = values[:, np.arange(steps) * values.shape[1] // steps] * scale
    return np.concatenate([held, -held])
