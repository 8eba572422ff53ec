"""float32 against float64 at k = 1e6 N/m: PyTorch rollouts against the compiled float64 one."""

from __future__ import annotations

import math

import numpy as np
import torch

from formulations.shooting.reference import reference_rollout
from formulations.shooting.rollout import rollout
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from validate.stress.case import Found, StressCase, at_least, at_most, finding, none_of, refusal

STIFFNESS = 1e6
STEP = 1e-4
STEPS = 600
# The carts start 1 mm apart and meet within 60 ms.
_START = (2.0, 2.501, 3.002, 0.3, 0.0, -0.3)


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("three_cart").with_parameters(k=STIFFNESS)
    u = np.tile([2.0, -2.0], (STEPS, 1))
    compiled = load_kernel(scene).rollout(np.array(_START), u, STEP)
    errors, gradients = {}, {}
    for dtype in (torch.float32, torch.float64):
        inputs = torch.tensor(u, dtype=dtype, requires_grad=True)
        q, v, _ = reference_rollout(scene, inputs, torch.tensor(_START, dtype=dtype), step=STEP)
        v[-1].sum().backward()
        errors[dtype] = float(np.abs(v.detach().double().numpy() - compiled.v).max())
        gradients[dtype] = (
            math.nan
            if inputs.grad is None or q.dtype != dtype
            else float(inputs.grad.double().norm())
        )
    wrong = refusal(
        "float32 for the compiled rollout",
        ["float64"],
        lambda: rollout(scene, torch.zeros((2, 2), dtype=torch.float32)),
    )
    single, double = errors[torch.float32], errors[torch.float64]
    return finding(
        f"Velocities are {single:.1e} m/s off in float32, {double:.0e} m/s in float64, of 0.3 m/s; the gradient norms are {gradients[torch.float32]:.6g} and "
        f"{gradients[torch.float64]:.6g}. Shooting takes float64 and says so to float32.",
        at_least(
            "error of float32",
            single,
            1e-4,
            "m/s",
            reason="a position of 2.5 m has 2e-7 m in float32, which k turns into 0.2 N",
        ),
        at_most(
            "error of float64", double, 1e-9, "m/s", reason="rounding of 600 steps with k = 1e6"
        ),
        none_of(
            "what is taken in float32",
            wrong,
            reason="the default is float64, and the only one of the compiled rollout",
        ),
    )


CASE = StressCase(
    title="float32 against float64 shooting at k = 1e6",
    expected="The difference is visible; the default is float64.",
    scenes=("three_cart",),
)
