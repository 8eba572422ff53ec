"""Microseconds of one gradient iteration on three carts over 500 steps, layer by layer, beside the loop of plain PyTorch operations.

kernel      compiled rollout + adjoint, called from Python
rollout     `rollout`, the loss of its tensors, and backward
iteration   the whole iteration of `descend`: that, history, stopping rule, step, projection
plain       the peer's iteration: 500 steps in PyTorch operations and plain SGD, as the paper's
            authors ran it

CPU time, all layers in turn in each repetition; smallest and median over repetitions, and the
median of the ratios of each repetition.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
import torch

from benchmarks.measure import Size, timed
from benchmarks.options import out_option
from benchmarks.records import Table
from benchmarks.results import store_tables
from benchmarks.suite.peers import torch_loop
from formulations.shooting.descent import descend
from formulations.shooting.objective import GoalLoss, Objective
from formulations.shooting.options import DescentOptions
from formulations.shooting.rollout import rollout
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw

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
        kernel.adjoint(
            kernel.rollout(start, values, 0.01, law, eps), values, cost_bar=5e-6, end_bar=end_bar
        )

    def differentiated() -> None:
        u.grad = None
        loss(rollout(kernel, u, objective.start, law=law, eps=eps), u).backward()

    # A rate that changes nothing to speak of: every iteration costs the same, and none stops the
    # descent.
    options = DescentOptions(learning_rate=1e-3, iterations=_ITERATIONS)
    return {
        "kernel": (compiled, 100, 1),
        "rollout": (differentiated, 100, 1),
        "iteration": (lambda: descend(objective, values, options, 600.0), 1, _ITERATIONS),
        "plain": (torch_loop.iteration(Size(3, 500), Path()), 1, 1),
    }


@click.command()
@out_option
def command(out: Path) -> int:
    """Microseconds of one gradient iteration on three carts over 500 steps, layer by layer, beside plain PyTorch."""
    torch.set_num_threads(1)
    rows, notes = [], []
    for law, eps in ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3)):
        name, layers = law.name.lower(), _layers(law, eps)
        found: dict[str, list[float]] = {layer: [] for layer in layers}
        for _ in range(_REPETITIONS):
            for layer, (function, calls, share) in layers.items():
                seconds = timed(
                    lambda function=function, calls=calls: [function() for _ in range(calls)]
                )[1]
                found[layer].append(1e6 * seconds / calls / share)
        rows += [
            (f"{name}: {layer}", min(times), statistics.median(times))
            for layer, times in found.items()
        ]
        ratio = statistics.median(
            plain / own for plain, own in zip(found["plain"], found["iteration"], strict=True)
        )
        notes.append(
            f"{name}: the loop of plain PyTorch operations takes {ratio:.0f} times as long an iteration."
        )
    told = Table(
        caption="CPU time of one call: what the code costs, and what a busy machine makes of it.",
        columns=("law: layer", "smallest [us]", "median [us]"), rows=tuple(rows),
        notes=tuple(notes),
    )  # fmt: skip
    store_tables(
        out,
        "shooting",
        "One gradient iteration, layer by layer",
        (__doc__ or "").split("\n\n")[0],
        [told],
    )
    return 0
