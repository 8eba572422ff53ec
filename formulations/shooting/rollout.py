"""The compiled time step of a scene as a PyTorch function with first derivatives.

    q, v, lam, cost, end = rollout(scene, u)  # true (ReLU) contact
    plan = rollout(scene, u, start, law=ContactLaw.SOFTPLUS, eps=1e-3)

- Leading dimensions are plans: u (B, steps, nu) gives q (B, steps+1, nq) and a cost (B,).
- The CPU code needs float64: use `rollout(scene, u.double())`.
- On another device the step is a loop of PyTorch operations (`reference`): for thousands of plans,
  without friction.
- A second derivative raises ShootingError. The ReLU has slope 0 at 0, as `torch.relu`.
- A diverged rollout has NaN values and gradients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from formulations.shooting.reference import reference_cost, reference_rollout
from models.codegen.kernel import Kernel, KernelError, load_kernel
from models.contact_law import ContactLaw
from models.errors import TouchstoneError
from models.scene import Scene


class ShootingError(TouchstoneError):
    """The compiled rollout cannot use these tensors, or lacks this derivative."""


class RolloutTensors(NamedTuple):
    """A rollout: q, v (.., steps+1, nq) [m, rad, m/s, rad/s]; lam (.., steps, nc+nf) [N].

    cost: (..) running and final cost
    end: (.., 2*nq) last positions and velocities, with a cheaper gradient
    """

    q: Tensor
    v: Tensor
    lam: Tensor
    cost: Tensor
    end: Tensor


Loss = Callable[[RolloutTensors, Tensor], Tensor]


def rollout(
    scene: Scene | Kernel,
    u: Tensor,
    start: Tensor | Sequence[float] | None = None,
    *,
    step: float | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> RolloutTensors:
    """Simulate a scene; leading dimensions are broadcast.

    Parameters
    ----------
    u : (.., steps, nu) [N, N m], inputs, constant over each step
    start : (.., 2*nq) [m, rad, m/s, rad/s], by default the task's
    step : [s], by default the task's
    law, eps : contact law, and eps of softplus [-], 0 < eps < 1

    Raises
    ------
    ShootingError
        for tensors of a wrong type, device or shape
    """
    kernel = load_kernel(scene) if isinstance(scene, Scene) else scene
    task = kernel.scene.task
    step = task.step if step is None else step
    if not isinstance(start, Tensor):
        like = (
            u
            if isinstance(u, Tensor) and u.device.type != "cpu"
            else torch.zeros((), dtype=torch.float64, device="cpu")
        )
        start = torch.tensor(
            task.start if start is None else start, dtype=like.dtype, device=like.device
        )
    _check(kernel.scene, u, start)
    if u.device.type != "cpu":
        q, v, lam = reference_rollout(kernel.scene, u, start, step=step, law=law, eps=eps)
        return RolloutTensors(
            q,
            v,
            lam,
            reference_cost(kernel.scene, q, v, u),
            torch.cat([q[..., -1, :], v[..., -1, :]], -1),
        )
    if u.shape[:-2] != start.shape[:-1]:
        rows = torch.broadcast_shapes(u.shape[:-2], start.shape[:-1])
        u, start = u.expand(*rows, *u.shape[-2:]), start.expand(*rows, start.shape[-1])
    return RolloutTensors(*_Rollout.apply(u, start, kernel, step, law, eps))


def _check(scene: Scene, u: Tensor, start: Tensor) -> None:
    for name, tensor, dimensions in (("u", u, 2), ("start", start, 1)):
        where = f"scene {scene.name}: {name}"
        if not isinstance(tensor, Tensor):
            raise ShootingError(
                f"{where} is a {type(tensor).__name__}, but the rollout takes PyTorch tensors; use torch.as_tensor(..., dtype=torch.float64)."
            )
        if tensor.dim() < dimensions:
            raise ShootingError(
                f"{where} has {tensor.dim()} dimensions, but needs {dimensions} or, for several plans, more."
            )
        if tensor.device.type == "cpu" and tensor.dtype != torch.float64:
            raise ShootingError(
                f"{where} is {tensor.dtype}, but the compiled rollout computes in torch.float64; pass {name}.double()."
            )
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
    @staticmethod
    def forward(
        ctx: Any,
        u: Tensor,
        start: Tensor,
        kernel: Kernel,
        step: float,
        law: ContactLaw,
        eps: float | None,
    ) -> tuple[Tensor, ...]:
        scene, rows, steps = kernel.scene, u.shape[:-2], u.shape[-2]
        u, start = u.contiguous(), start.contiguous()
        shapes = (
            (steps + 1, scene.nq),
            (steps + 1, scene.nq),
            (steps, scene.nl),
            (),
            (2 * scene.nq,),
        )
        outputs = tuple(u.new_empty((*rows, *shape)) for shape in shapes)
        head = kernel.head(steps, step, law, eps)
        kernel.library.kernel_rollouts(
            rows.numel(),
            *head,
            start.data_ptr(),
            u.data_ptr(),
            *(tensor.data_ptr() for tensor in outputs),
        )
        ctx.save_for_backward(u, *outputs[:3])
        ctx.set_materialize_grads(False)
        ctx.head, ctx.kernel = head, kernel
        return outputs

    @staticmethod
    def backward(ctx: Any, *bars: Tensor | None) -> tuple[Tensor | None, ...]:
        u, q, v, lam = ctx.saved_tensors
        bars = tuple(None if bar is None else bar.contiguous() for bar in bars)
        gradients = [torch.empty_like(u), u.new_empty((*u.shape[:-2], 2 * q.shape[-1]))]
        rows, tensors = u.shape[:-2].numel(), (q, v, lam, u, *bars, *gradients)
        addresses = (None if tensor is None else tensor.data_ptr() for tensor in tensors)
        done = ctx.kernel.library.kernel_adjoints(rows, *ctx.head, *addresses)
        if done < rows:
            raise KernelError(
                f"scene {ctx.kernel.scene.name}: the mass matrix is not positive definite along rollout {done}."
            )
        if torch.is_grad_enabled():  # create_graph=True: another derivative must raise
            parents = [
                tensor for tensor in (u, q, *bars) if tensor is not None and tensor.requires_grad
            ]
            gradients = [_FirstDerivativeOnly.apply(gradient, *parents) for gradient in gradients]
        return (*gradients, None, None, None, None)


class _FirstDerivativeOnly(torch.autograd.Function):
    """The identity on a gradient; differentiating it raises."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *parents: Tensor) -> Tensor:
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> Tensor:
        raise ShootingError(
            "the compiled rollout can be differentiated once, but a second derivative was requested; "
            "use formulations.shooting.reference.reference_rollout, which is plain PyTorch."
        )
