"""The loss of single shooting, in PyTorch operations on `rollout`.

    loss = terminal_weight * mean((x_T - x_f)^2) + input_weight * sum of the running cost
    objective = Objective(load_kernel(scene), law=ContactLaw.SOFTPLUS, eps=1e-3)
    objective(u).backward()  # u (steps, nu), a tensor that requires a gradient

The paper prints no loss; weights 1 and 5e-6 and the mean over all positions and velocities
reproduce its rows. A custom loss is a function of a rollout (RolloutTensors) and its inputs with
one number per plan, passed as `loss`.
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
    """Weights of the mean squared terminal error and of the running cost."""

    terminal: float = 1.0
    running: float = 5e-6


class GoalLoss:
    """The paper's loss (..) of rollouts; goal (2*nq,) is None or NaN for a free end."""

    def __init__(
        self, goal: Sequence[float | None] | np.ndarray, weights: Weights | None = None
    ) -> None:
        values = np.array(goal, dtype=float)
        self.weights = Weights() if weights is None else weights
        self._goal = torch.from_numpy(np.nan_to_num(values))
        self._asked = torch.from_numpy(~np.isnan(values)) if np.isnan(values).any() else None

    def __call__(self, plan: RolloutTensors, u: Tensor) -> Tensor:
        """Return the loss (..) [-] of each rollout."""
        if (self._goal.device, self._goal.dtype) != (plan.end.device, plan.end.dtype):
            self._goal = self._goal.to(plan.end)
            self._asked = None if self._asked is None else self._asked.to(plan.end.device)
        error = plan.end - self._goal
        if self._asked is not None:
            error = torch.where(self._asked, error, 0.0)
        # Summed in a fixed order, so that the rounding does not depend on the processor.
        squares = (error * error).cumsum(-1)[..., -1]
        return self.weights.terminal * squares / len(self._goal) + self.weights.running * plan.cost


class Objective:
    """A loss as a function of inputs (steps, nu), and the state of its last evaluation.

    goal: (2*nq,), reference of terminal_error, and the aim unless `loss` is given; NaN where free
    plan: the last rollout
    seconds: wall seconds of the evaluations
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
        """Set the goal (2*nq,) [m, rad, m/s, rad/s] and the weights; a custom loss is unchanged.

        Raises ValueError for a goal that is not numeric.
        """
        self.goal, self.weights = goal, weights
        self.loss = GoalLoss(goal, weights) if self._own is None else self._own

    def __call__(self, u: Tensor) -> Tensor:
        """Return the differentiable loss at u (steps, nu), not finite for a diverged rollout.

        Raises ShootingError for a custom loss that is no number, or does not depend on the plan.
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
        """Return whether the last rollout stayed finite."""
        return self.finite_steps == len(self._inputs)

    @property
    def finite_steps(self) -> int:
        """Return the number of finite steps of the last rollout."""
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
        """Return whether the loss is the paper's, which `aim` changes."""
        return self._own is None

    def missed(self, goal: np.ndarray) -> np.ndarray:
        """Return x_T - goal (2*nq,) [m, rad, m/s, rad/s] of the last rollout, 0 where free.

        Raises ValueError for a goal of another length.
        """
        assert self.plan is not None
        return miss(self.plan.end.detach().numpy(), goal)

    @property
    def error(self) -> np.ndarray:
        """Return x_T minus the goal aimed at (2*nq,) [m, rad, m/s, rad/s], 0 where free.

        Raises AssertionError before the first evaluation.
        """
        return self.missed(self.goal)

    @property
    def terminal_error(self) -> float:
        """Return |x_T - goal| over positions and velocities."""
        error = self.error
        return math.sqrt(float(error @ error))

    @property
    def cost(self) -> float:
        """Return the scene's cost of the last rollout."""
        assert self.plan is not None
        return self.plan.cost.item()

    def value(self, u: np.ndarray) -> float:
        """Return the loss at u (steps, nu) [N, N m], infinite if the rollout diverges.

        Raises ShootingError as `__call__`.
        """
        began = perf_counter()
        self._inputs = torch.tensor(u, dtype=torch.float64, requires_grad=True)
        self._value = self(self._inputs)
        loss = self._value.item()
        self.seconds += perf_counter() - began
        return loss if math.isfinite(loss) else math.inf

    def gradient(self) -> np.ndarray:
        """Return the gradient (steps, nu) [1/N, 1/N/m] at the inputs of the last `value`.

        Raises KernelError if the mass matrix is not positive definite along the rollout.
        """
        began = perf_counter()
        (gradient,) = torch.autograd.grad(self._value, self._inputs, retain_graph=True)
        self.seconds += perf_counter() - began
        return gradient.numpy()
