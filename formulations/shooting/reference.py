"""The rollout in plain PyTorch: slow, simple, differentiable to any order, on any device.

    q, v, lam = reference_rollout(scene, u, start)

It shares only the SymPy equations with the compiled kernel, which is tested against it, and is a
thousand times slower. Dry friction acts by the slips at the end of the step,
s(f) = s0 + h W f with W = S M^-1 S', and the limits mu N:

    Coulomb       |f| <= mu N,  f minimises f's / 2 + s0' f:   s = 0, or f = -mu N sign(s)
    regularised   f = -mu N tanh(c s),                         c = |ln eps| / (2 nominal)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import sympy as sp
import torch
from torch import Tensor

from models.contact_law import ContactLaw, sharpness
from models.dynamics import derive
from models.scene import Scene
from models.scene.contacts import DampingLaw

_SWEEPS = 10000
# Change of a force relative to its limit that ends the sweeps.
_SETTLED = 1e-15


def friction_forces(s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor | None) -> Tensor:
    """Return the friction forces (.., nf) [N] of one step of many plans.

    Sweeps without derivatives find the forces; a Newton step on the equations that hold makes them
    differentiable twice, away from the corners between stick and slip.
    - s0: (.., nf) [m/s], slips at the end of the step without friction
    - hw: (.., nf, nf) [m/s/N], h W
    - limit: (.., nf) [N], mu N
    - steepness: (nf,) [s/m], c of the regularised law; None for Coulomb's
    """
    nf = s0.shape[-1]
    rows = [
        coulomb(s, w, most) if steepness is None else regularised(s, w, most, steepness)
        for s, w, most in zip(
            s0.reshape(-1, nf), hw.reshape(-1, nf, nf), limit.reshape(-1, nf), strict=True
        )
    ]
    return torch.stack(rows).reshape(s0.shape)


def coulomb(s0: Tensor, hw: Tensor, limit: Tensor) -> Tensor:
    """Return Coulomb's forces (nf,) [N]; s0 (nf,) [m/s], hw (nf, nf) [m/s/N], limit (nf,) [N]."""
    held, sticks = _swept(s0.detach(), hw.detach(), limit.detach(), None)
    slipping = torch.sign(held) * limit * ~sticks
    if not bool(sticks.any()):
        return slipping
    index = torch.nonzero(sticks)[:, 0]
    rest = (s0 + hw @ slipping)[index]
    return slipping.index_add(0, index, -torch.linalg.solve(hw[index][:, index], rest))


def regularised(s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor) -> Tensor:
    """Return the forces of the regularised law, with steepness c (nf,) [s/m]."""
    f, _ = _swept(s0.detach(), hw.detach(), limit.detach(), steepness)
    one = torch.eye(len(f), dtype=f.dtype, device=f.device)
    for _ in range(3):  # the first refines, each adds an order of derivatives
        g = torch.tanh(steepness * (s0 + hw @ f))
        slope = one + (limit * steepness * (1.0 - g**2))[:, None] * hw
        f = f - torch.linalg.solve(slope, f + limit * g)
    return f


def _swept(
    s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor | None
) -> tuple[Tensor, Tensor]:
    f = torch.zeros_like(s0)
    for _ in range(_SWEEPS):
        before = f.clone()
        for j in range(len(f)):
            if limit[j] <= 0.0:
                continue
            w = hw[j, j]
            rest = s0[j] + hw[j] @ f - w * f[j]
            if steepness is None:
                f[j] = (
                    torch.clamp(-rest / w, -limit[j], limit[j])
                    if w > 0.0
                    else -torch.sign(rest) * limit[j]
                )
            else:
                f[j] = _root(float(rest), float(w), float(limit[j]), float(steepness[j]))
        if bool(((f - before).abs() <= _SETTLED * limit).all()):
            break
    return f, f.abs() < limit


def _root(rest: float, w: float, limit: float, c: float) -> float:
    """Solve f + limit tanh(c (rest + w f)) = 0 for f by bisection; the left side increases."""
    low, high = -limit, limit
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if (
            middle
            + limit * float(torch.tanh(torch.tensor(c * (rest + w * middle), dtype=torch.float64)))
            > 0.0
        ):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def reference_rollout(
    scene: Scene,
    u: Tensor,
    start: Tensor,
    *,
    step: float | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Simulate lam[t] = L(phi(q[t])), v[t+1] = v[t] + h M^-1 (tau + J' lam), q[t+1] = q[t] + h v.

    - u: (.., steps, nu) [N, N m], inputs
    - start: (.., 2*nq) [m, rad, m/s, rad/s], with the dtype and device of the rollout
    - step: h [s], by default the task's
    - law, eps: contact law, and eps of softplus [-]

    Return q (.., steps+1, nq) [m, rad], v (.., steps+1, nq) [m/s, rad/s] and lam (.., steps, nc+nf)
    [N], contact forces before friction forces.
    """
    h = scene.task.step if step is None else step
    force = _contact_law(law, eps, scene.length)
    d = derive(scene)
    arguments = (d.q, d.v, d.u, (*d.lam, *d.f))
    kind = {"dtype": start.dtype, "device": start.device}
    penetration, stiffness = (
        _torch_function(scene, d.penetration, d.q, **kind),
        _torch_function(scene, d.stiffness, **kind)(),
    )
    acceleration = _acceleration(scene, arguments, **kind)
    damped = _damped_forces(scene, law, eps, **kind) if scene.damped else None
    friction = _friction_forces(scene, law, eps, h, acceleration, **kind) if scene.nf else None
    start = start.expand(*torch.broadcast_shapes(u.shape[:-2], start.shape[:-1]), 2 * scene.nq)
    q, v, lam = [start[..., : scene.nq]], [start[..., scene.nq :]], []
    for inputs in u.unbind(-2):
        lam.append(force(penetration(q[-1]), stiffness))
        if damped is not None:
            lam[-1] = damped(lam[-1], q[-1], v[-1])
        if friction is not None:
            lam[-1] = torch.cat([lam[-1], friction(q[-1], v[-1], inputs, lam[-1])], -1)
        v.append(v[-1] + h * acceleration(q[-1], v[-1], inputs, lam[-1]))
        q.append(q[-1] + h * v[-1])
    return (
        torch.stack(q, -2),
        torch.stack(v, -2),
        torch.stack(lam, -2) if lam else start.new_zeros((*start.shape[:-1], 0, scene.nl)),
    )


def reference_cost(scene: Scene, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Return the cost (..) [-] of q, v (.., steps+1, nq) [SI], u (.., steps, nu) [N, N m]."""
    d = derive(scene)
    kind = {"dtype": q.dtype, "device": q.device}
    running = _torch_function(scene, sp.Matrix([d.running_cost]), d.q, d.v, d.u, **kind)
    final = _torch_function(scene, sp.Matrix([d.final_cost]), d.q, d.v, **kind)
    return running(q[..., :-1, :], v[..., :-1, :], u).sum((-2, -1)) + final(
        q[..., -1, :], v[..., -1, :]
    ).sum(-1)


def _contact_law(
    law: ContactLaw, eps: float | None, length: float
) -> Callable[[Tensor, Tensor], Tensor]:
    if law is ContactLaw.RELU:
        return lambda phi, k: k * torch.relu(phi)
    b = sharpness(eps if eps is not None else 0.0, length)
    # torch.nn.functional.softplus turns linear beyond 20; logaddexp does not.
    return lambda phi, k: k / b * torch.logaddexp(b * phi, torch.zeros_like(phi))


def _damped_forces(
    scene: Scene, law: ContactLaw, eps: float | None, **kind: Any
) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return a function (lam, q, v) -> lam with the forces of the damped contacts.

    Laws and smoothing are those of models.scene.contacts and models/codegen/damping.h.
    """
    d = derive(scene)
    rate = -d.gap_jacobian * sp.Matrix(d.v)
    quantities = (sp.Matrix([d.penetration, d.stiffness, d.damping, rate]), d.q, d.v)
    evaluate, nc = _torch_function(scene, *quantities, **kind), scene.nc
    is_linear = torch.tensor(
        [contact.damping_law is DampingLaw.KELVIN_VOIGT for contact in scene.contacts],
        device=kind["device"],
    )
    is_damped = torch.tensor(
        [contact.is_damped for contact in scene.contacts], device=kind["device"]
    )
    soft = _contact_law(law, eps, scene.length)  # k times the smoothed positive part
    pure = _contact_law(law, eps, 1.0)  # of a number, with b L

    def forces(lam: Tensor, q: Tensor, v: Tensor) -> Tensor:
        phi, k, c, r = evaluate(q, v).unflatten(-1, (4, nc)).unbind(-2)
        closed = (
            (phi > 0).to(phi.dtype)
            if law is ContactLaw.RELU
            else torch.sigmoid(sharpness(eps if eps is not None else 0.0, scene.length) * phi)
        )
        kelvin_voigt = (
            soft(phi + closed * c * r / k, k)
            if law is ContactLaw.SOFTPLUS
            else closed * soft(phi + c * r / k, k)
        )
        one = torch.ones_like(k)
        return torch.where(
            is_damped,
            torch.where(
                is_linear, kelvin_voigt, soft(phi, k) * pure(1 + c * r, one) / pure(one, one)
            ),
            lam,
        )

    return forces


def _friction_forces(
    scene: Scene,
    law: ContactLaw,
    eps: float | None,
    h: float,
    acceleration: Callable[..., Tensor],
    **kind: Any,
) -> Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]:
    d = derive(scene)
    slip, limit = (
        _torch_function(scene, d.slip, d.q, d.v, **kind),
        _torch_function(scene, d.friction_limit, d.q, d.lam, **kind),
    )
    steepness = None
    if law is ContactLaw.SOFTPLUS:
        nominal = torch.tensor([friction.nominal for friction in scene.frictions], **kind)
        steepness = sharpness(eps if eps is not None else 0.0) / (2.0 * nominal)
    units = torch.eye(scene.nf, **kind)

    def forces(q: Tensor, v: Tensor, u: Tensor, lam: Tensor) -> Tensor:
        def moved(f: Tensor) -> Tensor:
            return acceleration(q, v, u, torch.cat([lam, f.expand(*lam.shape[:-1], scene.nf)], -1))

        free = moved(torch.zeros_like(units[0]))
        s0 = slip(q, v + h * free)
        hw = h * torch.stack([slip(q, moved(unit) - free) for unit in units], -1)
        return friction_forces(s0, hw, torch.clamp(limit(q, lam), min=0.0), steepness)

    return forces


def _acceleration(
    scene: Scene,
    arguments: tuple[Sequence[sp.Symbol], ...],
    dtype: torch.dtype,
    device: torch.device | str = "cpu",
) -> Callable[..., Tensor]:
    d = derive(scene)
    if d.acceleration is not None:
        return _torch_function(scene, d.acceleration, *arguments, dtype=dtype, device=device)
    mass, force = (
        _torch_function(scene, d.mass_matrix, d.q, dtype=dtype, device=device),
        _torch_function(scene, d.generalised_force, *arguments, dtype=dtype, device=device),
    )
    square = (scene.nq, scene.nq)
    return lambda q, v, u, lam: torch.linalg.solve(
        mass(q).unflatten(-1, square), force(q, v, u, lam).unsqueeze(-1)
    ).squeeze(-1)


def _torch_function(
    scene: Scene,
    expressions: sp.Matrix,
    *groups: Sequence[sp.Symbol],
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Callable[..., Tensor]:
    parameters = tuple(parameter.symbol for parameter in scene.parameters)
    compiled = _compiled(
        (parameters, *(tuple(group) for group in groups)),
        tuple(sp.sympify(entry) for entry in expressions),
    )
    values = [
        torch.tensor(parameter.value, dtype=dtype, device=device) for parameter in scene.parameters
    ]

    def function(*vectors: Tensor) -> Tensor:
        rows = torch.broadcast_shapes(*(vector.shape[:-1] for vector in vectors))
        results = compiled(values, *(vector.unbind(-1) for vector in vectors))
        if not results:
            return torch.zeros(*rows, 0, dtype=dtype, device=device)
        return torch.stack(
            [
                torch.as_tensor(result, dtype=dtype, device=device).expand(rows)
                for result in results
            ],
            -1,
        )

    return function


# PyTorch's integers have 64 bits.
_LARGEST_INT = 2**63


@lru_cache(maxsize=128)
def _compiled(
    groups: tuple[tuple[sp.Symbol, ...], ...], entries: tuple[sp.Expr, ...]
) -> Callable[..., list[Any]]:
    """Return the entries as a function of one sequence of tensors per group.

    Cached: a function takes 10 ms (three carts) or 50 ms (two fingers), a loop over 500 steps 100
        or
    650. Constants are floats, because torch functions accept tensors only (`torch.sqrt(2)` fails).
    """
    plain = [
        entry.replace(
            lambda e: e.is_number and not (e.is_Integer and abs(e) < _LARGEST_INT),
            lambda e: e.evalf(17),
        )
        for entry in entries
    ]
    return sp.lambdify([list(group) for group in groups], plain, modules="torch", cse=True)
