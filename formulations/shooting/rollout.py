"""The compiled time step of a scene as a PyTorch function that can be differentiated once.

    q, v, lam, cost = rollout(scene, u)                                       # true (ReLU) contact
    q, v, lam, cost = rollout(scene, u, start, law=ContactLaw.SOFTPLUS, eps=1e-3)

Values come from the C kernel, gradients with respect to `u` and `start` from its adjoint. Any loss of the outputs may be built
on top. Decisions:

- float64 on the CPU only. Another type or device is refused, not converted in silence: `rollout(scene, u.double())` lets
  gradients flow back to a float32 tensor, and says in the caller's code where precision changes.
- First derivatives only; `create_graph=True` followed by a second backward raises ShootingError.
- At a penetration of exactly zero the ReLU has slope 0, as in `torch.relu`.
- A rollout that diverges gives NaN from there on, and NaN gradients, as PyTorch functions do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from formulations.shooting.errors import ShootingError
from formulations.shooting.objective import Weights
from models.codegen.kernel import Kernel, Rollout, load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene


class RolloutTensors(NamedTuple):
    """q, v: (steps+1, nq) [m, rad]; lam: (steps, nc) [N]; cost: () sum of the scene's running cost over the steps."""

    q: Tensor
    v: Tensor
    lam: Tensor
    cost: Tensor


def rollout(
    scene: Scene | Kernel,
    u: Tensor,
    start: Tensor | Sequence[float] | None = None,
    *,
    step: float | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> RolloutTensors:
    """Simulate `scene` with inputs u (steps, nu), held over each step of `step` seconds, from start (2*nq,).

    start and step: those of the scene's task unless given. eps: sharpness of the softplus law, 0 < eps < 1.
    """
    kernel = load_kernel(scene) if isinstance(scene, Scene) else scene
    task = kernel.scene.task
    start = torch.tensor(task.start if start is None else start, dtype=torch.float64) if not isinstance(start, Tensor) else start
    for name, tensor in (("u", u), ("start", start)):
        _check(kernel.scene, name, tensor)
    return RolloutTensors(*_Rollout.apply(u, start, kernel, task.step if step is None else step, law, eps))


def plan_loss(plan: RolloutTensors, goal: Tensor, weights: Weights) -> Tensor:
    """terminal * mean((x_T - goal)^2) + running * cost, with x_T = (q_T, v_T) and goal (2*nq,), NaN where free (no error there)."""
    error = torch.where(goal.isnan(), 0.0, torch.cat([plan.q[-1], plan.v[-1]]) - goal)
    return weights.terminal * error.square().mean() + weights.running * plan.cost


def _check(scene: Scene, name: str, tensor: object) -> None:
    where = f"scene {scene.name}: {name}"
    if not isinstance(tensor, Tensor):
        raise ShootingError(
            f"{where} is a {type(tensor).__name__}, but the rollout takes PyTorch tensors; use torch.as_tensor(..., dtype=torch.float64)."
        )
    if tensor.dtype != torch.float64:
        raise ShootingError(f"{where} is {tensor.dtype}, but the compiled rollout computes in torch.float64; pass {name}.double().")
    if tensor.device.type != "cpu":
        raise ShootingError(f"{where} is on {tensor.device}, but the compiled rollout runs on the CPU; pass {name}.cpu().")


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, start: Tensor, kernel: Kernel, step: float, law: ContactLaw, eps: float | None) -> tuple[Tensor, ...]:
        result = kernel.rollout(start.detach().numpy(), u.detach().numpy(), step, law, eps)
        cost = np.nan if result.diverged else kernel.cost(result.q, result.v, u.detach().numpy())
        outputs = tuple(torch.from_numpy(array) for array in (result.q, result.v, result.lam))
        ctx.save_for_backward(u, *outputs)
        ctx.set_materialize_grads(False)
        ctx.kernel, ctx.step, ctx.law, ctx.eps, ctx.finite_steps = kernel, step, law, eps, result.finite_steps
        return (*outputs, torch.tensor(cost, dtype=torch.float64))

    @staticmethod
    def backward(ctx: Any, *bars: Tensor | None) -> tuple[Tensor | None, ...]:
        u, q, v, lam = ctx.saved_tensors
        result = Rollout(
            q=_numpy(q), v=_numpy(v), lam=_numpy(lam), finite_steps=ctx.finite_steps, step=ctx.step, law=ctx.law, eps=ctx.eps
        )  # fmt: skip
        if result.diverged:
            u_bar, start_bar = np.full(u.shape, np.nan), np.full(2 * q.shape[1], np.nan)
        else:
            q_bar, v_bar, lam_bar, cost_bar = bars
            u_bar, start_bar = ctx.kernel.adjoint(
                result,
                _numpy(u),
                np.zeros_like(result.q) if q_bar is None else _numpy(q_bar),
                np.zeros_like(result.v) if v_bar is None else _numpy(v_bar),
                None if lam_bar is None else _numpy(lam_bar),
                0.0 if cost_bar is None else float(cost_bar),
            )
        gradients = [
            torch.from_numpy(array) if needed else None for array, needed in zip((u_bar, start_bar), ctx.needs_input_grad, strict=False)
        ]
        if torch.is_grad_enabled():  # create_graph=True: whoever differentiates these again shall be told
            parents = [tensor for tensor in (u, q, *bars) if tensor is not None and tensor.requires_grad]
            gradients = [None if gradient is None else FirstDerivativeOnly.apply(gradient, *parents) for gradient in gradients]
        return (*gradients, None, None, None, None)


class FirstDerivativeOnly(torch.autograd.Function):
    """The identity on a gradient that cannot be differentiated again; depends on what it came from, so that trying raises."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *parents: Tensor) -> Tensor:
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> Tensor:
        raise ShootingError(
            "the compiled rollout can be differentiated once, but a second derivative was asked for; "
            "use formulations.shooting.reference.reference_rollout, which is plain PyTorch."
        )


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().numpy()
