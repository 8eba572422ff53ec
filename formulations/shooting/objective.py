"""The loss that is descended: how far from the goal the plan ends, plus a little of what it costs.

    loss = terminal_weight * mean((x_T - x_f)^2) + input_weight * sum of the running cost

The paper prints no loss; terminal_weight = 1, input_weight = 5e-6 and the mean over all positions and velocities reproduce its
rows. `plan_loss` is this formula on tensors. `Objective` is the same as one PyTorch function of the inputs, in buffers
that are reused: what a descent calls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from formulations.shooting.errors import ShootingError
from formulations.shooting.rollout import FirstDerivativeOnly, RolloutTensors
from models.codegen.kernel import Kernel
from models.codegen.workspace import Workspace
from models.contact_law import ContactLaw

PAPER_INPUT_WEIGHT = 5e-6


@dataclass(frozen=True, kw_only=True)
class Weights:
    terminal: float = 1.0
    running: float = PAPER_INPUT_WEIGHT


def plan_loss(plan: RolloutTensors, goal: Tensor, weights: Weights) -> Tensor:
    """terminal * mean((x_T - goal)^2) + running * cost, with x_T = (q_T, v_T) and goal (2*nq,), NaN where free (no error there)."""
    error = torch.where(goal.isnan(), 0.0, torch.cat([plan.q[-1], plan.v[-1]]) - goal)
    return weights.terminal * error.square().mean() + weights.running * plan.cost


class Objective:
    """`loss = objective(u); loss.backward()` with u (steps, nu) float64; facts of the last evaluation stand beside it.

    work: the last rollout; error (2*nq,): x_T - goal, 0 where the end is free; cost: its running cost; evaluate_seconds: wall seconds in compiled code.
    A loss must be sent backward before the next one is evaluated, because its buffers are reused.
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
        self.evaluations = 0

    def __call__(self, u: Tensor) -> Tensor:
        return _Loss.apply(u, self)

    @property
    def finite(self) -> bool:
        """Whether the last rollout stayed finite to its end."""
        return self.work.finite_steps == self.work.steps

    @property
    def terminal_error(self) -> float:
        """|x_T - goal| over positions and velocities."""
        return math.hypot(*self.error.tolist())

    def value(self, u: np.ndarray) -> float:
        """The loss at inputs u (steps, nu); infinite if the rollout diverges."""
        started = perf_counter()
        finite = self.work.rollout(u)
        self.cost = self.work.cost() if finite else np.nan
        self.evaluate_seconds += perf_counter() - started
        self.evaluations += 1
        if not finite:
            self.error[:] = np.nan
            return np.inf
        nq = len(self.goal) // 2
        np.subtract(self.work.q[-1], self.goal[:nq], out=self.error[:nq])
        np.subtract(self.work.v[-1], self.goal[nq:], out=self.error[nq:])
        self.error[self._free] = 0.0
        squares = sum(error * error for error in self.error.tolist())  # plain floats: an overflow is an answer here, not a warning
        return self.weights.terminal * squares / len(self.error) + self.weights.running * self.cost

    def gradient(self) -> np.ndarray:
        """Gradient (steps, nu) of the loss at the inputs evaluated last; the buffer is overwritten by the next call."""
        np.multiply(self.error, 2.0 * self.weights.terminal / len(self.error), out=self.work.end_bar)
        started = perf_counter()
        gradient = self.work.adjoint(self.weights.running)
        self.evaluate_seconds += perf_counter() - started
        return gradient


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, objective: Objective) -> Tensor:
        ctx.objective = objective
        value = objective.value(u.detach().numpy())
        ctx.evaluation = objective.evaluations
        ctx.save_for_backward(u)
        return torch.tensor(value, dtype=torch.float64)

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor, None]:
        objective, (u,) = ctx.objective, ctx.saved_tensors
        if objective.evaluations != ctx.evaluation:
            raise ShootingError("this loss was evaluated again before its backward(), and its buffers are reused; call backward() first.")
        gradient = torch.from_numpy(objective.gradient() * float(bars[0]) if objective.finite else np.full(u.shape, np.nan))
        return (FirstDerivativeOnly.apply(gradient, u) if torch.is_grad_enabled() else gradient), None
