"""The compiled time step of a scene as a PyTorch function that can be differentiated once.

    q, v, lam, cost = rollout(scene, u)                                       # true (ReLU) contact
    q, v, lam, cost = rollout(scene, u, start, law=ContactLaw.SOFTPLUS, eps=1e-3)

Values come from the C kernel, gradients with respect to `u` and `start` from its adjoint. Any loss of the outputs may be built
on top. Decisions:

- Leading dimensions are plans of their own: u (B, steps, nu) gives q (B, steps+1, nq) and a cost (B,), in one call, each row as if alone.
- The compiled code computes in float64 on the CPU. Another type is refused, not converted in silence: `rollout(scene, u.double())` lets
  gradients flow back to a float32 tensor, and says in the caller's code where precision changes.
- Tensors on another device (CUDA) never visit the CPU: the same time step is then a loop of PyTorch operations on that device, in the tensors'
  own float type (formulations/shooting/reference.py). One plan is a thousand times slower so; thousands at once are what it is for. Scenes with friction are refused there.
- First derivatives only on the CPU; `create_graph=True` followed by a second backward raises ShootingError.
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
from formulations.shooting.reference import reference_cost, reference_rollout
from models.codegen.batch import adjoints, rollouts
from models.codegen.kernel import Kernel, load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene


class RolloutTensors(NamedTuple):
    """q, v: (.., steps+1, nq) [m, rad]; lam: (.., steps, nc+nf) [N]; cost: (..) sum of the scene's running cost over the steps, and the final one."""

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
    """Simulate `scene` with inputs u (.., steps, nu), held over each step of `step` seconds, from start (.., 2*nq); leading dimensions are
    broadcast.

    start and step: those of the scene's task unless given. eps: sharpness of the softplus law, 0 < eps < 1. Raises ShootingError for tensors it does not take.
    """
    kernel = load_kernel(scene) if isinstance(scene, Scene) else scene
    task = kernel.scene.task
    step = task.step if step is None else step
    if not isinstance(start, Tensor):
        like = u if isinstance(u, Tensor) and u.device.type != "cpu" else torch.zeros((), dtype=torch.float64, device="cpu")
        start = torch.tensor(task.start if start is None else start, dtype=like.dtype, device=like.device)
    _check(kernel.scene, u, start)
    if u.device.type != "cpu":
        q, v, lam = reference_rollout(kernel.scene, u, start, step=step, law=law, eps=eps)
        return RolloutTensors(q, v, lam, reference_cost(kernel.scene, q, v, u))
    rows = torch.broadcast_shapes(u.shape[:-2], start.shape[:-1])
    plans, starts = (tensor.expand(*rows, *tensor.shape[-own:]) for tensor, own in ((u, 2), (start, 1)))
    if len(rows) != 1:
        plans, starts = plans.reshape(rows.numel(), *u.shape[-2:]), starts.reshape(rows.numel(), -1)
    found = _Rollout.apply(plans, starts, kernel, step, law, eps)
    return RolloutTensors(*(found if len(rows) == 1 else (tensor.reshape((*rows, *tensor.shape[1:])) for tensor in found)))


def plan_loss(plan: RolloutTensors, goal: Tensor, weights: Weights) -> Tensor:
    """(..): terminal * mean((x_T - goal)^2) + running * cost, with x_T = (q_T, v_T) and goal (2*nq,), NaN where free (no error there)."""
    error = torch.where(goal.isnan(), 0.0, torch.cat([plan.q[..., -1, :], plan.v[..., -1, :]], -1) - goal)
    return weights.terminal * error.square().mean(-1) + weights.running * plan.cost


def _check(scene: Scene, u: object, start: object) -> None:
    for name, tensor, dimensions in (("u", u, 2), ("start", start, 1)):
        where = f"scene {scene.name}: {name}"
        if not isinstance(tensor, Tensor):
            raise ShootingError(
                f"{where} is a {type(tensor).__name__}, but the rollout takes PyTorch tensors; use torch.as_tensor(..., dtype=torch.float64)."
            )
        if tensor.dim() < dimensions:
            raise ShootingError(f"{where} has {tensor.dim()} dimensions, but needs {dimensions} or, for several plans, more.")
        if tensor.device.type == "cpu" and tensor.dtype != torch.float64:
            raise ShootingError(f"{where} is {tensor.dtype}, but the compiled rollout computes in torch.float64; pass {name}.double().")
    if isinstance(u, Tensor) and isinstance(start, Tensor):
        if (u.device, u.dtype) != (start.device, start.dtype):
            raise ShootingError(
                f"scene {scene.name}: u is {u.dtype} on {u.device}, start {start.dtype} on {start.device}; pass start.to(u.device, u.dtype)."
            )
        if u.device.type != "cpu" and scene.nf:
            raise ShootingError(
                f"scene {scene.name}: u is on {u.device}, but a scene with friction has a compiled rollout only, on the CPU; pass u.cpu()."
            )
        sizes = (u.shape[-1], start.shape[-1])
        if sizes != (scene.nu, 2 * scene.nq):
            raise ShootingError(
                f"scene {scene.name}: the last dimensions of u and start are {sizes[0]} and {sizes[1]}, but {scene.nu} inputs and "
                f"{2 * scene.nq} positions and velocities are needed."
            )


class _Rollout(torch.autograd.Function):
    """Of u (rows, steps, nu) and start (rows, 2*nq)."""

    @staticmethod
    def forward(ctx: Any, u: Tensor, start: Tensor, kernel: Kernel, step: float, law: ContactLaw, eps: float | None) -> tuple[Tensor, ...]:
        found = rollouts(kernel, start.detach().numpy(), u.detach().numpy(), step, law, eps)
        outputs = tuple(torch.from_numpy(array) for array in (found.q, found.v, found.lam, found.cost))
        ctx.save_for_backward(u, *outputs)
        ctx.set_materialize_grads(False)
        ctx.kernel, ctx.found = kernel, found
        return outputs

    @staticmethod
    def backward(ctx: Any, *bars: Tensor | None) -> tuple[Tensor | None, ...]:
        u, *outputs = ctx.saved_tensors
        rows = [np.zeros(tensor.shape) if bar is None else _numpy(bar) for bar, tensor in zip(bars, outputs, strict=True)]
        found = adjoints(ctx.kernel, ctx.found, _numpy(u), *rows)
        gradients = [torch.from_numpy(array) if needed else None for array, needed in zip(found, ctx.needs_input_grad, strict=False)]
        if torch.is_grad_enabled():  # create_graph=True: whoever differentiates these again shall be told
            parents = [tensor for tensor in (u, outputs[0], *bars) if tensor is not None and tensor.requires_grad]
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
