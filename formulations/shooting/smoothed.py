"""The loss averaged over random inputs: contact that only some samples make still has a gradient.

    objective = SmoothedObjective(kernel, weights=..., noise=noise(scene, deviation=1.0, samples=16, pieces=5, seed=0))

F(u) = mean over i of loss(u + w_i), with rollouts through the true contact law and first-order gradients, averaged ("bundled": Suh, Pang,
Tedrake, Bundled Gradients through Contact via Randomized Smoothing, RA-L 2022). The w_i are drawn once, in pairs w and -w, and are the
same in every evaluation: F is one function, its minimisation deterministic, and its curvature can be learned. Each w_i is held over a
piece of the horizon, because noise that changes with every step averages out before it moves a body.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from formulations.shooting.compiled import CompiledLoss
from formulations.shooting.objective import Objective, Weights
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
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


class SmoothedObjective(Objective):
    """See the module docstring. error, cost and work are those of u itself, without noise."""

    smoothed = True

    def __init__(self, kernel: Kernel, *, weights: Weights, noise: np.ndarray) -> None:
        super().__init__(kernel, law=ContactLaw.RELU, weights=weights)
        self._noise = np.ascontiguousarray(noise, dtype=np.float64)
        self._gradient = np.zeros(noise.shape[1:])
        self._compiled = CompiledLoss(self)

    def value(self, u: np.ndarray) -> float:
        """The mean loss at u (steps, nu); infinite if a sample diverges."""
        started = perf_counter()
        mean = self._compiled.mean(u, self._noise, self._gradient)
        self.evaluate_seconds += perf_counter() - started
        return mean if np.isfinite(super().value(u)) else np.inf

    def gradient(self) -> np.ndarray:
        return self._gradient
