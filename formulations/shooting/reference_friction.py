"""Dry friction in the rollout of plain PyTorch: the forces of one time step, their derivatives by the implicit function theorem.

With s(f) = s0 + h W f the slips at the end of the step, W = S M^-1 S', and the limits mu N:

    Coulomb        |f| <= mu N,  f minimises f's / 2 + s0' f:   s = 0, or f = -mu N sign(s)
    regularised    f = -mu N tanh(c s),                         c = |ln eps| / (2 nominal)

Which forces stick, and roughly how large they are, is found without derivatives by sweeps over single forces; the equations that then hold are
solved once more by a Newton step that PyTorch differentiates: exact first and second derivatives, away from the corners between stick and slip.
"""

from __future__ import annotations

import torch
from torch import Tensor

_SWEEPS = 10000
_SETTLED = 1e-15  # change of a force in parts of its limit


def friction_forces(s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor | None) -> Tensor:
    """f (.., nf) [N] of one step of many plans, one by one: s0, limit (.., nf), hw (.., nf, nf); steepness (nf,), None for Coulomb's law."""
    nf = s0.shape[-1]
    rows = [
        coulomb(s, w, most) if steepness is None else regularised(s, w, most, steepness)
        for s, w, most in zip(s0.reshape(-1, nf), hw.reshape(-1, nf, nf), limit.reshape(-1, nf), strict=True)
    ]
    return torch.stack(rows).reshape(s0.shape)


def coulomb(s0: Tensor, hw: Tensor, limit: Tensor) -> Tensor:
    """f (nf,) [N] from s0 (nf,) [m/s], hw = h W (nf, nf), limit mu N (nf,) [N]."""
    held, sticks = _swept(s0.detach(), hw.detach(), limit.detach(), None)
    slipping = torch.sign(held) * limit * ~sticks
    if not bool(sticks.any()):
        return slipping
    index = torch.nonzero(sticks)[:, 0]
    rest = (s0 + hw @ slipping)[index]
    return slipping.index_add(0, index, -torch.linalg.solve(hw[index][:, index], rest))


def regularised(s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor) -> Tensor:
    """The same with the logistic law; steepness c (nf,) [s/m]."""
    f, _ = _swept(s0.detach(), hw.detach(), limit.detach(), steepness)
    one = torch.eye(len(f), dtype=f.dtype, device=f.device)
    for _ in range(3):  # the first polishes, each carries derivatives one order further
        g = torch.tanh(steepness * (s0 + hw @ f))
        slope = one + (limit * steepness * (1.0 - g**2))[:, None] * hw
        f = f - torch.linalg.solve(slope, f + limit * g)
    return f


def _swept(s0: Tensor, hw: Tensor, limit: Tensor, steepness: Tensor | None) -> tuple[Tensor, Tensor]:
    """Forces by sweeps over single ones, and which of them stick (Coulomb)."""
    f = torch.zeros_like(s0)
    for _ in range(_SWEEPS):
        before = f.clone()
        for j in range(len(f)):
            if limit[j] <= 0.0:
                continue
            w = hw[j, j]
            rest = s0[j] + hw[j] @ f - w * f[j]
            if steepness is None:
                f[j] = torch.clamp(-rest / w, -limit[j], limit[j]) if w > 0.0 else -torch.sign(rest) * limit[j]
            else:
                f[j] = _root(float(rest), float(w), float(limit[j]), float(steepness[j]))
        if bool(((f - before).abs() <= _SETTLED * limit).all()):
            break
    return f, f.abs() < limit


def _root(rest: float, w: float, limit: float, c: float) -> float:
    """f of f + limit tanh(c (rest + w f)) = 0, whose left side increases: bisection."""
    low, high = -limit, limit
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if middle + limit * float(torch.tanh(torch.tensor(c * (rest + w * middle), dtype=torch.float64))) > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)
