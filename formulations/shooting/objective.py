"""The loss that is descended: how far from the goal the plan ends, plus a little of what it costs.

    loss = terminal_weight * mean((x_T - x_f)^2) + input_weight * sum of the running cost

The paper prints no loss; terminal_weight = 1, input_weight = 5e-6 and the mean over all positions and velocities reproduce its
rows. `Objective` evaluates it in buffers that are reused; compiled.py is the same within loops of compiled code. The formula on PyTorch
tensors, for a loss of one's own, is `rollout.plan_loss`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from models.codegen.kernel import Kernel
from models.codegen.workspace import Workspace
from models.contact_law import ContactLaw

PAPER_INPUT_WEIGHT = 5e-6


@dataclass(frozen=True, kw_only=True)
class Weights:
    terminal: float = 1.0
    running: float = PAPER_INPUT_WEIGHT


class Objective:
    """`loss = objective.value(u)`, then `objective.gradient()`, with u (steps, nu); facts of the last evaluation stand beside it.

    work: the last rollout; error (2*nq,): x_T - goal, 0 where the end is free; cost: its running cost; evaluate_seconds: wall seconds in compiled code.
    """

    smoothed = False  # whether the gradient is another than that of the last rollout

    def __init__(
        self,
        kernel: Kernel,
        *,
        law: ContactLaw,
        eps: float | None = None,
        weights: Weights | None = None,
        goal: Sequence[float | None] | None = None,
    ):
        task = kernel.scene.task
        self.work = Workspace(kernel, task.start, steps=task.steps, step=task.step, law=law, eps=eps)
        self.weights = Weights() if weights is None else weights
        self.goal = np.array(task.goal if goal is None else goal, dtype=float)
        self._free = np.isnan(self.goal)
        self.error = np.full_like(self.goal, np.nan)
        self.cost = np.nan
        self.evaluate_seconds = 0.0

    @property
    def finite(self) -> bool:
        """Whether the last rollout stayed finite to its end."""
        return self.work.finite_steps == self.work.steps

    @property
    def terminal_error(self) -> float:
        """|x_T - goal| over positions and velocities."""
        return math.sqrt(_squares(self.error))

    def value(self, u: np.ndarray) -> float:
        """The loss at inputs u (steps, nu); infinite if the rollout diverges."""
        started = perf_counter()
        finite = self.work.rollout(u)
        self.cost = self.work.cost() if finite else np.nan
        self.evaluate_seconds += perf_counter() - started
        if not finite:
            self.error[:] = np.nan
            return np.inf
        nq = len(self.goal) // 2
        np.subtract(self.work.q[-1], self.goal[:nq], out=self.error[:nq])
        np.subtract(self.work.v[-1], self.goal[nq:], out=self.error[nq:])
        self.error[self._free] = 0.0
        return self.weights.terminal * _squares(self.error) / len(self.error) + self.weights.running * self.cost

    def gradient(self) -> np.ndarray:
        """Gradient (steps, nu) of the loss at the inputs evaluated last; the buffer is overwritten by the next call."""
        np.multiply(self.error, 2.0 * self.weights.terminal / len(self.error), out=self.work.end_bar)
        started = perf_counter()
        gradient = self.work.adjoint(self.weights.running)
        self.evaluate_seconds += perf_counter() - started
        return gradient


def _squares(error: np.ndarray) -> float:
    """Sum of squares from the first to the last, as compiled code adds them up; an overflow is an answer here, not a warning."""
    total = 0.0
    for entry in error.tolist():
        total += entry * entry
    return total
