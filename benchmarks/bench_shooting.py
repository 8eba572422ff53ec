"""Microseconds of one gradient iteration on three carts over 500 steps, layer by layer.

    python benchmarks/bench_shooting.py [--plain]

kernel      compiled rollout + adjoint in reused buffers, called from Python
loss        loss and gradient of an Objective, called from Python
iteration   the whole iteration of `descend`, compiled: loss, gradient, history, stopping rule, step, projection
rollout     a user's own loss on `rollout`: fresh tensors, plain PyTorch operations for the loss
plain       the reference, 500 steps in PyTorch operations (--plain; seconds)

CPU time, smallest and median over repetitions: the smallest is what the code costs, the median what a busy machine makes of it.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable
from time import process_time

import numpy as np
import torch

from formulations.shooting.descent import Settings, descend
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.reference import reference_rollout
from formulations.shooting.rollout import RolloutTensors, plan_loss, rollout
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw

_REPETITIONS = 60
_CALLS = 50


def _microseconds(
    function: Callable[[], object], calls: int = _CALLS, repetitions: int = _REPETITIONS, share: int = 1
) -> tuple[float, float]:
    """Smallest and median CPU microseconds of a call, divided by `share`."""
    function()
    times = []
    for _ in range(repetitions):
        started = process_time()
        for _ in range(calls):
            function()
        times.append((process_time() - started) / calls / share * 1e6)
    return min(times), statistics.median(times)


def _measure(law: ContactLaw, eps: float | None, plain: bool) -> dict[str, tuple[float, float]]:
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    objective = Objective(kernel, law=law, eps=eps)
    goal = torch.tensor(scene.task.goal, dtype=torch.float64)
    u = torch.from_numpy(np.random.default_rng(0).normal(size=(500, 2))).requires_grad_()
    values, zeros = u.detach().numpy(), np.zeros((500, 2))

    def compiled() -> None:
        objective.work.rollout(values)
        objective.work.adjoint(5e-6)

    def loss() -> None:
        objective.value(values)
        objective.gradient()

    def own_loss() -> None:
        u.grad = None
        plan_loss(rollout(kernel, u, law=law, eps=eps), goal, Weights()).backward()

    def plain_loss() -> None:
        u.grad = None
        q, v, lam = reference_rollout(scene, u, torch.tensor(scene.task.start, dtype=torch.float64), law=law, eps=eps)
        plan_loss(RolloutTensors(q, v, lam, u.square().sum()), goal, Weights()).backward()

    # A rate that changes nothing to speak of: every iteration costs the same, and none stops the descent.
    settings = Settings(learning_rate=1e-3, iterations=100)
    rows = {
        "kernel": _microseconds(compiled),
        "loss": _microseconds(loss),
        "iteration": _microseconds(lambda: descend(objective, zeros, settings, 60.0), calls=1, share=100),
        "rollout": _microseconds(own_loss),
    }
    if plain:
        rows["plain"] = _microseconds(plain_loss, calls=1, repetitions=3)
    return rows


def main() -> None:
    plain = "--plain" in sys.argv[1:]
    torch.set_num_threads(1)
    print(f"{'law':10} {'layer':10} {'smallest us':>12} {'median us':>12}")
    for law, eps in ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-5)):
        rows = _measure(law, eps, plain)
        for name, (smallest, median) in rows.items():
            print(f"{law.name.lower():10} {name:10} {smallest:12.1f} {median:12.1f}")
        print(
            f"{law.name.lower():10} step, history and stopping rule add {rows['iteration'][1] - rows['kernel'][1]:.0f} us to the kernel's {rows['kernel'][1]:.0f} us (medians)"
        )


if __name__ == "__main__":
    main()
