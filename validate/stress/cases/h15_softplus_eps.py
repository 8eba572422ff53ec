"""Softplus with extreme eps: 1e-300, 1e-16 and 0.999 give finite forces; eps of 1 or more, 0, less, or no number is refused in words, by whoever takes it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from formulations import ContactFormulation as Transcription
from formulations import build_model
from formulations.pipelines import load_method
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw, contact_force
from models.errors import TouchstoneError
from validate.stress.case import CaseFinding, HardCase, at_most, none_of

USABLE = (1e-300, 1e-16, 1e-3, 0.999)
REFUSED = (1.0, 1.5, 0.0, -1e-3, math.nan, math.inf)
# Far into both tails: at eps = 1e-300 the sharpness is 691, so that exp(b phi) of 1e4 m would be e^(6.9e6).
DEPTHS = np.array([-1e4, -10.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 10.0, 1e4])


def measure() -> CaseFinding:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    # the left contact at each depth: phi = d - (q2 - q1)
    q = np.column_stack([DEPTHS - 0.5, np.zeros_like(DEPTHS), np.full_like(DEPTHS, 2e4)])
    wrong, apart = [], 0.0
    for eps in USABLE:
        compiled = kernel.contact_force(q, ContactLaw.SOFTPLUS, eps)[:, 0]
        reference = contact_force(DEPTHS, 30.0, ContactLaw.SOFTPLUS, eps)
        plan = kernel.rollout(np.array(scene.task.start), np.tile([5.0, -5.0], (200, 1)), 0.01, ContactLaw.SOFTPLUS, eps)
        gradients = kernel.adjoint(plan, np.zeros((200, 2)), np.ones_like(plan.q), np.ones_like(plan.v))
        if plan.diverged or not all(np.isfinite(array).all() for array in (compiled, reference, *gradients)):
            wrong.append(f"eps {eps:g} is not finite")
        if (compiled < 0.0).any() or (np.diff(compiled) < 0.0).any():
            wrong.append(f"eps {eps:g}: a force pulls, or falls with the depth")
        apart = max(apart, float(np.abs((compiled - reference) / np.maximum(np.abs(reference), 1e-30)).max()))
    takers: dict[str, Callable[[float], object]] = {
        "the compiled law": lambda eps: kernel.contact_force(q, ContactLaw.SOFTPLUS, eps),
        "softplus_dc": load_method("softplus_dc").check_eps,
        "softplus_gd": load_method("softplus_gd").check_eps,
        "build_model": lambda eps: build_model(scene, Transcription.SOFTPLUS, eps=eps, steps=2),
    }
    for name, take in takers.items():
        for eps in REFUSED:
            try:
                take(eps)
            except TouchstoneError as error:
                if "eps" not in str(error):
                    wrong.append(f"{name} refuses {eps!r} without naming eps: {error}")
            else:
                wrong.append(f"{name} takes {eps!r}")
    return CaseFinding(
        happened=f"Finite over 20 km of depth for {', '.join(f'{eps:g}' for eps in USABLE)}; {', '.join(repr(eps) for eps in REFUSED)} refused by {len(takers)} takers.",
        figures=(
            none_of("non-finite results or accepted nonsense inputs", wrong, reason="no overflow, and a sentence that names eps"),
            at_most("compiled law against the reference, relative", apart, 1e-13, reason="the same formula, but for the order of rounding"),
        ),
    )


CASE = HardCase(
    name="h15_softplus_eps",
    title="Softplus with extreme eps",
    expected="No overflow at 1e-300, 1e-16, 0.999; refused where meaningless (eps >= 1, eps <= 0, NaN).",
    scenes=("three_cart",),
    methods=("softplus_dc", "softplus_gd"),
    measure=measure,
    quick=True,
)
