"""Long horizons: linear growth of time and memory, and a correct adjoint."""

from __future__ import annotations

import math
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

from formulations import ContactFormulation as Transcription
from formulations import build_model
from formulations.ipopt import compile_model
from models.catalog import load_scene
from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from validate.stress.case import Found, StressCase, at_most, chart, finding

LENGTHS = (5000, 20000, 80000)
MODEL_LENGTHS = (500, 1000, 2000)
# Largest exponent of memory over steps; sorting sparse rows adds a little to 1.
EXPONENT = 1.15
# Largest exponent of CPU time over steps: between linear and quadratic. Load and cache sizes cause
# up to 1.2.
TIME_EXPONENT = 1.5

_REPEATS = 20
_MODEL_REPEATS = 2
_DIFFERENCE = 1e-4
_WEIGHTS = (1.0, 2.0, 3.0)


def _squeeze(steps: int) -> np.ndarray:
    return np.tile([3.0, -3.0], (steps, 1)) + np.random.default_rng(8).normal(
        scale=0.3, size=(steps, 2)
    )


def _gradient_of(kernel: Kernel, steps: int) -> Callable[[], np.ndarray]:
    """Return an iteration of descent: rollout, and adjoint of a sum of the last positions."""
    task, u = kernel.scene.task, _squeeze(steps)

    def _iteration() -> np.ndarray:
        plan = kernel.rollout(np.array(task.start), u, task.step)
        return kernel.adjoint(plan, u, end_bar=np.array((*_WEIGHTS, 0.0, 0.0, 0.0)))[0]

    return _iteration


def _measured(make: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Return the least CPU seconds of the work of `make`, and its peak memory [MB]."""
    work, seconds = make(), []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    del work
    tracemalloc.start()
    try:
        make()()
        return min(seconds), tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def _exponent(lengths: tuple[int, ...], values: list[float]) -> float:
    return math.log(values[-1] / values[0]) / math.log(lengths[-1] / lengths[0])


def _model(scene: Scene, steps: int) -> Any:
    return compile_model(build_model(scene, Transcription.SOFTPLUS, eps=1e-3, steps=steps))


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    gradients = [_measured(lambda n=n: _gradient_of(kernel, n), _REPEATS) for n in LENGTHS]
    _model(scene, 50)  # excludes imports and compilation
    models = [
        _measured(lambda n=n: lambda: _model(scene, n), _MODEL_REPEATS) for n in MODEL_LENGTHS
    ]
    u, u_bar = _squeeze(LENGTHS[1]), _gradient_of(kernel, LENGTHS[1])()
    direction = np.random.default_rng(9).normal(size=u.shape)
    ends = [
        float(
            kernel.rollout(
                np.array(scene.task.start), u + sign * _DIFFERENCE * direction, scene.task.step
            ).q[-1]
            @ _WEIGHTS
        )
        for sign in (1.0, -1.0)
    ]
    slope = (ends[0] - ends[1]) / (2.0 * _DIFFERENCE)
    wrong = abs(float((u_bar * direction).sum()) / slope - 1.0)
    memory = {
        "gradient, memory": _exponent(LENGTHS, [held for _, held in gradients]),
        "model, memory": _exponent(MODEL_LENGTHS, [held for _, held in models]),
    }
    seconds = {
        "gradient, time": _exponent(LENGTHS, [spent for spent, _ in gradients]),
        "model, time": _exponent(MODEL_LENGTHS, [spent for spent, _ in models]),
    }
    return finding(
        f"A gradient over {LENGTHS[-1]} steps takes {gradients[-1][0] * 1e3:.0f} ms and {gradients[-1][1]:.0f} MB; a model of {MODEL_LENGTHS[-1]} steps is built and "
        f"translated in {models[-1][0]:.1f} s and {models[-1][1]:.0f} MB. The adjoint over {LENGTHS[1]} steps is that of differences to {wrong:.0e}.",
        *(
            at_most(f"growth exponent of the {name}", value, EXPONENT, reason="about linear")
            for name, value in memory.items()
        ),
        *(
            at_most(
                f"growth exponent of the {name}",
                value,
                TIME_EXPONENT,
                reason="halfway between linear and quadratic",
            )
            for name, value in seconds.items()
        ),
        at_most(
            "adjoint against differences, T = 20000",
            wrong,
            1e-6,
            reason="central differences of a smooth end",
        ),
        charts=(
            chart(
                "CPU time against the number of steps",
                x=("steps", ""),
                y=("CPU seconds", "s"),
                series={
                    "rollout and adjoint": (LENGTHS, [row[0] for row in gradients]),
                    "softplus model, built and translated": (
                        MODEL_LENGTHS,
                        [row[0] for row in models],
                    ),
                },
                log="xy",
            ),
        ),
    )


CASE = StressCase(
    title="Long horizon, T = 5000, 20000 and 80000",
    expected="Time and memory grow about linearly; the adjoint equals finite differences to 1e-6.",
    scenes=("three_cart",),
)
