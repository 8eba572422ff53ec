"""Microseconds of one gradient iteration on three carts over 500 steps, layer by layer, beside the loop of plain PyTorch operations.

    python benchmarks/bench_shooting.py

kernel      compiled rollout + adjoint, called from Python
rollout     `rollout`, the loss of its tensors, and backward
iteration   the whole iteration of `descend`: that, history, stopping rule, torch.optim.SGD, projection
plain       the peer's iteration: 500 steps in PyTorch operations and plain SGD, as the paper's authors ran it

CPU time, all layers in turn in each repetition; smallest and median over repetitions, and the median of the ratios of each repetition.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import torch

from formulations.shooting.descent import descend
from formulations.shooting.method import DescentOptions
from formulations.shooting.objective import GoalLoss, Objective
from formulations.shooting.rollout import rollout
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from validate.bench.case import Size
from validate.bench.peers import torch_loop

_REPETITIONS = 15
_ITERATIONS = 200


def _layers(law: ContactLaw, eps: float | None) -> dict[str, tuple[Callable[[], object], int, int]]:
    """Name -> what is called, calls in a repetition, iterations in a call."""
    scene = load_scene("three_cart")
    kernel, loss = load_kernel(scene), GoalLoss(scene.task.goal)
    objective, start = Objective(kernel, law=law, eps=eps), np.array(scene.task.start)
    u = torch.from_numpy(np.random.default_rng(0).normal(size=(500, 2))).requires_grad_()
    values, end_bar = u.detach().numpy(), np.ones(6)

    def compiled() -> None:
        kernel.adjoint(kernel.rollout(start, values, 0.01, law, eps), values, cost_bar=5e-6, end_bar=end_bar)

    def differentiated() -> None:
        u.grad = None
        loss(rollout(kernel, u, objective.start, law=law, eps=eps), u).backward()

    # A rate that changes nothing to speak of: every iteration costs the same, and none stops the descent.
    options = DescentOptions(learning_rate=1e-3, iterations=_ITERATIONS)
    return {
        "kernel": (compiled, 100, 1),
        "rollout": (differentiated, 100, 1),
        "iteration": (lambda: descend(objective, values, options, 600.0), 1, _ITERATIONS),
        "plain": (torch_loop.iteration(Size(3, 500), Path()), 1, 1),
    }


def main() -> None:
    torch.set_num_threads(1)
    print(f"{'law':10} {'layer':10} {'smallest us':>12} {'median us':>12}")
    for law, eps in ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3)):
        layers = _layers(law, eps)
        seconds: dict[str, list[float]] = {name: [] for name in layers}
        for _ in range(_REPETITIONS):
            for name, (function, calls, share) in layers.items():
                began = process_time()
                for _ in range(calls):
                    function()
                seconds[name].append((process_time() - began) / calls / share)
        for name, times in seconds.items():
            print(f"{law.name.lower():10} {name:10} {1e6 * min(times):12.1f} {1e6 * statistics.median(times):12.1f}")
        ratio = statistics.median(plain / own for plain, own in zip(seconds["plain"], seconds["iteration"], strict=True))
        print(f"{law.name.lower():10} the loop of plain PyTorch operations takes {ratio:.0f} times as long an iteration")


if __name__ == "__main__":
    main()
