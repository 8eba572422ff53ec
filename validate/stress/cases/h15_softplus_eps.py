"""Softplus with extreme eps: 1e-300, 1e-16 and 0.999 give finite forces.

Eps of 1 or more, 0, less, or no number is refused in words, by whoever takes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from formulations import ContactFormulation as Transcription
from formulations import build_model
from formulations.pipelines import load_method
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw, contact_force
from validate.stress.case import Found, StressCase, at_most, finding, none_of, refusal

USABLE = (1e-300, 1e-16, 1e-3, 0.999)
REFUSED = (1.0, 1.5, 0.0, -1e-3, math.nan, math.inf)
# Far into both tails: at eps = 1e-300 the sharpness is 691, so that exp(b phi) of 1e4 m would be
# e^(6.9e6).
DEPTHS = np.array([-1e4, -10.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 10.0, 1e4])


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    # the left contact at each depth: phi = d - (q2 - q1)
    q = np.column_stack([DEPTHS - 0.5, np.zeros_like(DEPTHS), np.full_like(DEPTHS, 2e4)])
    wrong, apart = [], 0.0
    for eps in USABLE:
        compiled = kernel.contact_force(q, ContactLaw.SOFTPLUS, eps)[:, 0]
        reference = contact_force(DEPTHS, 30.0, ContactLaw.SOFTPLUS, eps)
        plan = kernel.rollout(
            np.array(scene.task.start),
            np.tile([5.0, -5.0], (200, 1)),
            0.01,
            ContactLaw.SOFTPLUS,
            eps,
        )
        gradients = kernel.adjoint(
            plan, np.zeros((200, 2)), np.ones_like(plan.q), np.ones_like(plan.v)
        )
        if plan.diverged or not all(
            np.isfinite(array).all() for array in (compiled, reference, *gradients)
        ):
            wrong.append(f"eps {eps:g} is not finite")
        if (compiled < 0.0).any() or (np.diff(compiled) < 0.0).any():
            wrong.append(f"eps {eps:g}: a force pulls, or falls with the depth")
        apart = max(
            apart,
            float(np.abs((compiled - reference) / np.maximum(np.abs(reference), 1e-30)).max()),
        )
    takers: dict[str, Callable[[float], object]] = {
        "the compiled law": lambda eps: kernel.contact_force(q, ContactLaw.SOFTPLUS, eps),
        "softplus_dc": load_method("softplus_dc").check_eps,
        "softplus_gd": load_method("softplus_gd").check_eps,
        "build_model": lambda eps: build_model(scene, Transcription.SOFTPLUS, eps=eps, steps=2),
    }
    for name, take in takers.items():
        for eps in REFUSED:
            wrong += refusal(f"{eps!r} for {name}", ["eps"], partial(take, eps))
    return finding(
        f"Finite over 20 km of depth for {', '.join(f'{eps:g}' for eps in USABLE)}; {', '.join(repr(eps) for eps in REFUSED)} refused by {len(takers)} takers.",
        none_of(
            "non-finite results or accepted nonsense inputs",
            wrong,
            reason="no overflow, and a sentence that names eps",
        ),
        at_most(
            "compiled law against the reference, relative",
            apart,
            1e-13,
            reason="the same formula, but for the order of rounding",
        ),
    )


CASE = StressCase(
    title="Softplus with extreme eps",
    expected="No overflow at 1e-300, 1e-16, 0.999; refused where meaningless (eps >= 1, eps <= 0, NaN).",
    scenes=("three_cart",),
    methods=("softplus_dc", "softplus_gd"),
    quick=True,
)
