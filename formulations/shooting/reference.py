"""The rollout in plain PyTorch operations, written from the scene's SymPy equations: slow, simple, differentiable to any order.

    q, v, lam = reference_rollout(scene, u, start)

It shares nothing with the compiled kernel but the equations themselves, and is what the kernel's values and gradients are
tested against. About a thousand times slower: use `formulations.shooting.rollout` to plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import sympy as sp
import torch
from torch import Tensor

from models.contact_law import ContactLaw, sharpness
from models.contacts import DampingLaw
from models.dynamics import derive
from models.errors import SceneError
from models.scene import Scene


def reference_rollout(
    scene: Scene,
    u: Tensor,
    start: Tensor,
    *,
    step: float | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """q, v (steps+1, nq) and lam (steps, nc) from inputs u (steps, nu) and start (2*nq,); step: that of the task unless given.

    All is computed in the dtype of start: float64, unless it is to be seen what float32 loses.

    lam[t] = L(phi(q[t])), v[t+1] = v[t] + h M^-1 (tau + J' lam), q[t+1] = q[t] + h v[t+1].
    """
    if scene.nf:
        raise SceneError(f"scene {scene.name}: it has friction, which the rollout in plain PyTorch does not write; use the compiled one.")
    h = scene.task.step if step is None else step
    force = _contact_law(law, eps)
    d = derive(scene)
    arguments = (d.q, d.v, d.u, d.lam)
    dtype = start.dtype
    penetration, stiffness = _torch_function(scene, d.penetration, d.q, dtype=dtype), _torch_function(scene, d.stiffness, dtype=dtype)()
    acceleration = _acceleration(scene, arguments, dtype)
    damped = _damped_forces(scene, law, eps, dtype) if scene.damped else None
    q, v, lam = [start[: scene.nq]], [start[scene.nq :]], []
    for inputs in u:
        lam.append(force(penetration(q[-1]), stiffness))
        if damped is not None:
            lam[-1] = damped(lam[-1], q[-1], v[-1])
        v.append(v[-1] + h * acceleration(q[-1], v[-1], inputs, lam[-1]))
        q.append(q[-1] + h * v[-1])
    return torch.stack(q), torch.stack(v), torch.stack(lam) if lam else u.new_zeros((0, scene.nc))


def _contact_law(law: ContactLaw, eps: float | None) -> Callable[[Tensor, Tensor], Tensor]:
    if law is ContactLaw.RELU:
        return lambda phi, k: k * torch.relu(phi)
    b = sharpness(eps if eps is not None else 0.0)
    # logaddexp neither overflows nor turns linear (as torch.nn.functional.softplus does beyond 20).
    return lambda phi, k: k / b * torch.logaddexp(b * phi, torch.zeros_like(phi))


def _damped_forces(scene: Scene, law: ContactLaw, eps: float | None, dtype: torch.dtype) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """(lam, q, v) -> lam with the forces of the damped contacts (laws and smoothing: models.contacts, models/codegen/damping.h)."""
    d = derive(scene)
    rate = -d.gap_jacobian * sp.Matrix(d.v)
    quantities = (sp.Matrix([d.penetration, d.stiffness, d.damping, rate]), d.q, d.v)
    evaluate, nc = _torch_function(scene, *quantities, dtype=dtype), scene.nc
    is_linear = torch.tensor([contact.damping_law is DampingLaw.KELVIN_VOIGT for contact in scene.contacts])
    is_damped = torch.tensor([contact.is_damped for contact in scene.contacts])
    soft = _contact_law(law, eps)  # k times the smoothed positive part

    def forces(lam: Tensor, q: Tensor, v: Tensor) -> Tensor:
        phi, k, c, r = evaluate(q, v).reshape(4, nc)
        closed = (phi > 0).to(dtype) if law is ContactLaw.RELU else torch.sigmoid(sharpness(eps if eps is not None else 0.0) * phi)
        kelvin_voigt = soft(phi + closed * c * r / k, k) if law is ContactLaw.SOFTPLUS else closed * soft(phi + c * r / k, k)
        one = torch.ones_like(k)
        return torch.where(is_damped, torch.where(is_linear, kelvin_voigt, soft(phi, k) * soft(1 + c * r, one) / soft(one, one)), lam)

    return forces


def _acceleration(scene: Scene, arguments: tuple[Sequence[sp.Symbol], ...], dtype: torch.dtype) -> Callable[..., Tensor]:
    d = derive(scene)
    if d.acceleration is not None:
        return _torch_function(scene, d.acceleration, *arguments, dtype=dtype)
    mass, force = (
        _torch_function(scene, d.mass_matrix, d.q, dtype=dtype),
        _torch_function(scene, d.generalised_force, *arguments, dtype=dtype),
    )
    return lambda q, v, u, lam: torch.linalg.solve(mass(q).reshape(scene.nq, scene.nq), force(q, v, u, lam))


def _torch_function(
    scene: Scene, expressions: sp.Matrix, *groups: Sequence[sp.Symbol], dtype: torch.dtype = torch.float64
) -> Callable[..., Tensor]:
    """Entries of a matrix, flattened row by row, as a function of vectors; parameters have the scene's values.

    Parameters enter as tensors and constants as floats, because PyTorch's functions take tensors only (`torch.sqrt(2)` fails).
    """
    entries = [sp.sympify(entry).replace(lambda e: e.is_number and not e.is_Number, lambda e: sp.Float(e, 17)) for entry in expressions]
    parameters = [parameter.symbol for parameter in scene.parameters]
    compiled = sp.lambdify([parameters, *(list(group) for group in groups)], entries, modules="torch", cse=True)
    values = [torch.tensor(parameter.value, dtype=dtype) for parameter in scene.parameters]

    def function(*vectors: Tensor) -> Tensor:
        results = compiled(values, *(vector.unbind() for vector in vectors))
        if not results:
            return torch.zeros(0, dtype=dtype)
        return torch.stack([torch.as_tensor(result, dtype=dtype) for result in results])

    return function
