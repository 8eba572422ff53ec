"""The loss that is descended, in PyTorch operations on `rollout`: how far from the goal the plan ends, plus a little of what it costs.

    loss = terminal_weight * mean((x_T - x_f)^2) + input_weight * sum of the running cost

The paper prints no loss; terminal_weight = 1, input_weight = 5e-6 and the mean over all positions
and velocities reproduce its rows.

    objective = Objective(load_kernel(scene), law=ContactLaw.SOFTPLUS, eps=1e-3)
    objective(u).backward()  # u (steps, nu), a tensor that requires a gradient

A loss of one's own is any function of a rollout (RolloutTensors) and its inputs that returns one
number for each plan:

    def calm(plan, u):
        return (plan.end - goal).square().mean(-1) + 1e-5 * u.diff(dim=-2).square().sum((-2, -1))

    objective = Objective(load_kernel(scene), law=ContactLaw.RELU, loss=calm)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import torch
from torch import Tensor

from formulations.shooting.rollout import Loss, RolloutTensors, ShootingError, rollout
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.scene.goal import goal_state, miss


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the mean squared terminal error and of the running cost in the loss."""

    terminal: float = 1.0
    running: float = 5e-6


class GoalLoss:
    """The paper's loss: (..) of the rollouts of inputs u (.., steps, nu). goal (2*nq,): None or NaN where the end is free."""

    def __init__(
        self, goal: Sequence[float | None] | np.ndarray, weights: Weights | None = None
    ) -> None:
        given = np.array(goal, dtype=float)
        self.weights = Weights() if weights is None else weights
        self._goal = torch.from_numpy(np.nan_to_num(given))
        self._asked = torch.from_numpy(~np.isnan(given)) if np.isnan(given).any() else None

    def __call__(self, plan: RolloutTensors, u: Tensor) -> Tensor:
        """Weigh the squared miss of the goal against the running cost: (..) [-] for each rollout."""
        if (self._goal.device, self._goal.dtype) != (plan.end.device, plan.end.dtype):
            self._goal = self._goal.to(plan.end)
            self._asked = None if self._asked is None else self._asked.to(plan.end.device)
        error = plan.end - self._goal
        if self._asked is not None:
            error = torch.where(self._asked, error, 0.0)
        squares = (error * error).cumsum(-1)[
            ..., -1
        ]  # added up from the first to the last, so that no processor does it otherwise
        return self.weights.terminal * squares / len(self._goal) + self.weights.running * plan.cost


class Objective:
    """A loss as a function of inputs (steps, nu) alone.

    Facts of the last evaluation stand beside it.

    goal (2*nq,): what terminal_error is measured from, and what the loss aims at unless `loss` is
    given (`aim`); NaN where free. plan: the last rollout; seconds: wall seconds spent so far.
    """

    def __init__(
        self,
        kernel: Kernel,
        *,
        law: ContactLaw,
        eps: float | None = None,
        weights: Weights | None = None,
        loss: Loss | None = None,
    ) -> None:
        task = kernel.scene.task
        self.kernel, self.law, self.eps = kernel, law, eps
        self.start = torch.tensor(task.start, dtype=torch.float64)
        self.seconds = 0.0
        self._own = loss
        self._inputs = torch.zeros(task.steps, kernel.scene.nu, dtype=torch.float64)
        self.plan: RolloutTensors | None = None
        self.aim(goal_state(task), Weights() if weights is None else weights)

    def aim(self, goal: np.ndarray, weights: Weights) -> None:
        """Change the goal (2*nq,) [m, rad, m/s, rad/s] and the weights.

        A loss of one's own stays as it is. Raises ValueError for a goal that holds no numbers.
        """
        self.goal, self.weights = goal, weights
        self.loss = GoalLoss(goal, weights) if self._own is None else self._own

    def __call__(self, u: Tensor) -> Tensor:
        """The loss at inputs u (steps, nu), a scalar that can be differentiated.

        Not finite if the rollout diverges.

        Raises ShootingError for a loss of one's own that is no number, or does not depend on the
        plan.
        """
        self.plan = rollout(self.kernel, u, self.start, law=self.law, eps=self.eps)
        value = self.loss(self.plan, u)
        if self._own is not None:
            self._check(value, u)
        return value

    def _check(self, value: object, u: Tensor) -> None:
        where = f"scene {self.kernel.scene.name}: the loss"
        if not isinstance(value, Tensor):
            raise ShootingError(
                f"{where} returned a {type(value).__name__}, but must return a PyTorch tensor of one number."
            )
        if value.dim():
            raise ShootingError(
                f"{where} returned a tensor of shape {tuple(value.shape)}, but a single number is needed; sum or average over the rest."
            )
        if u.requires_grad and not value.requires_grad:
            raise ShootingError(
                f"{where} has no gradient with respect to the inputs; compute it from the rollout by PyTorch operations, without detach or item."
            )

    @property
    def finite(self) -> bool:
        """Whether the last rollout stayed finite to its end."""
        return self.finite_steps == len(self._inputs)

    @property
    def finite_steps(self) -> int:
        """How many steps of the last rollout stayed finite."""
        if self.plan is None or not math.isnan(self.plan.cost.item()):
            return len(self._inputs)
        rows = torch.isfinite(self.plan.q).all(-1) & torch.isfinite(self.plan.v).all(-1)
        return (
            max(0, int(rows.to(torch.int8).argmin()) - 1)
            if not bool(rows.all())
            else len(self._inputs)
        )

    @property
    def aims(self) -> bool:
        """Whether the loss is that of the module docstring, which `aim` changes."""
        return self._own is None

    def missed(self, goal: np.ndarray) -> np.ndarray:
        """Give x_T - goal (2*nq,) [m, rad, m/s, rad/s] of the last rollout, 0 where the goal is free. Raises ValueError for a goal of another length."""
        assert self.plan is not None
        return miss(self.plan.end.detach().numpy(), goal)

    @property
    def error(self) -> np.ndarray:
        """x_T minus the goal aimed at: (2*nq,) [m, rad, m/s, rad/s], 0 where it is free.

        Raises AssertionError before the first evaluation.
        """
        return self.missed(self.goal)

    @property
    def terminal_error(self) -> float:
        """|x_T - goal| over positions and velocities."""
        error = self.error
        return math.sqrt(float(error @ error))

    @property
    def cost(self) -> float:
        """The scene's cost of the last rollout."""
        assert self.plan is not None
        return self.plan.cost.item()

    def value(self, u: np.ndarray) -> float:
        """Evaluate the loss at inputs u (steps, nu) [N, N m]; infinite if the rollout diverges.

        Raises ShootingError as `__call__` does.
        """
        began = perf_counter()
        self._inputs = torch.tensor(u, dtype=torch.float64, requires_grad=True)
        self._value = self(self._inputs)
        found = self._value.item()
        self.seconds += perf_counter() - began
        return found if math.isfinite(found) else math.inf

    def gradient(self) -> np.ndarray:
        """Differentiate the loss at the inputs that `value` evaluated last: (steps, nu) [1/N, 1/N/m]. Raises KernelError where the mass matrix is not positive definite along the rollout."""
        began = perf_counter()
        (found,) = torch.autograd.grad(self._value, self._inputs, retain_graph=True)
        self.seconds += perf_counter() - began
        return found.numpy()
