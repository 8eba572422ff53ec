"""Gradient descent as the paper's authors ran it: a loop over the steps in PyTorch operations, backward through all of them, plain SGD."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.measure import Size, Work
from benchmarks.suite.carts import INPUT_WEIGHT, numbers_of, push

_RATE = 1e-9


def iteration(size: Size, folder: Path) -> Work:
    import torch

    torch.set_num_threads(1)
    carts = numbers_of(size)
    n, h = carts.n, carts.step
    start, goal = torch.from_numpy(carts.start), torch.from_numpy(carts.goal)
    u = torch.from_numpy(push(size.steps)).requires_grad_()
    nothing = torch.zeros(n - 2, dtype=torch.float64)
    zero = torch.zeros(1, dtype=torch.float64)

    def loss() -> Any:
        q, v = start[:n], start[n:]
        for inputs in u:
            contact = carts.stiffness * torch.relu(carts.length - (q[1:] - q[:-1]))
            force = torch.cat([inputs[:1], nothing, inputs[1:]]) - carts.damping * v
            force = force + torch.cat([zero, contact]) - torch.cat([contact, zero])
            v = v + h / carts.mass * force
            q = q + h * v
        return (torch.cat([q, v]) - goal).square().mean() + INPUT_WEIGHT * u.square().sum()

    optimiser = torch.optim.SGD([u], lr=_RATE)
    optimiser.zero_grad()
    loss().backward()  # what PyTorch loads at its first backward and first step is not the loop's
    optimiser.step()

    def work() -> Mapping[str, Any]:
        optimiser.zero_grad()
        loss().backward()
        optimiser.step()
        return {"iterations": 1, "value": float(torch.linalg.vector_norm(u.grad))}

    return work
