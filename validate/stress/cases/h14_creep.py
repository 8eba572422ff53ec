"""Stick-slip and creep: cargo on a cart that accelerates at half of what friction can hold. Dry friction sticks; regularised friction creeps.

mu is swept, and the step goes to zero: the creep is a property of the law, not of the grid. Above what friction can hold the cargo slips at the
known acceleration.
"""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from models.contact_law import ContactLaw, sharpness
from models.scene import Scene
from validate.stress.case import Found, StressCase, at_least, at_most, chart, finding
from validate.stress.motion import replayed, rolled

COEFFICIENTS = (0.05, 0.1, 0.2, 0.4, 0.8)
STEPS = (0.02, 0.01, 0.005, 0.0025, 0.00125)
SECONDS, EPS, GRAVITY, MASS = 0.5, 1e-3, 9.81, 3.0
SHARE = 0.5  # of what friction can hold
_AT_REST = (0.0,) * 4


def _pulled(scene: Scene, mu: float, share: float, step: float, law: ContactLaw):
    """The motion from rest under a force that asks `share` of the friction there is; mu: its coefficient."""
    u = np.full((round(SECONDS / step), 1), share * mu * GRAVITY * MASS)
    return rolled(scene, start=_AT_REST, u=u, step=step, law=law, eps=EPS if law is ContactLaw.SOFTPLUS else None)


def _slip_speed(plan) -> float:
    """Largest slip at the end of the motion [m/s]."""
    return float(abs(plan.v[-1, 0] - plan.v[-1, 1]))


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    base = load_scene("transport")
    creeps, sticks, replay_slips, slipping = [], [], [], []
    for mu in COEFFICIENTS:
        scene = base.with_parameters(mu=mu)
        creeps.append(_slip_speed(_pulled(scene, mu, SHARE, STEPS[0], ContactLaw.SOFTPLUS)))
        stuck = _pulled(scene, mu, SHARE, STEPS[0], ContactLaw.RELU)
        sticks.append(float(np.abs(stuck.v[:, 0] - stuck.v[:, 1]).max()))
        told = replayed(scene, stuck, like=base)
        replay_slips.append(float(np.abs(told.v[:, 0] - told.v[:, 1]).max()) if told.ok else np.inf)
        moving = _pulled(scene, mu, 4.0, STEPS[0], ContactLaw.RELU)
        truth = replayed(scene, moving, like=base)
        # Friction gives the cargo mu g at most; the cart has what is left of the force, on 2 kg.
        exact = (4.0 * mu * GRAVITY * MASS - mu * GRAVITY) / 2.0 - mu * GRAVITY
        slip = abs(truth.v[-1, 1] - truth.v[-1, 0]) if truth.ok else np.inf
        slipping.append(abs(slip / (exact * SECONDS) - 1.0) if exact * SECONDS**2 / 2 < 0.9 else 0.0)
    by_step = {
        mu: [_slip_speed(_pulled(base.with_parameters(mu=mu), mu, SHARE, h, ContactLaw.SOFTPLUS)) for h in STEPS] for mu in (0.05, 0.2, 0.8)
    }
    settled = max(abs(values[-1] / values[-2] - 1.0) for values in by_step.values())
    return finding(
        f"Regularised friction creeps at {min(creeps):.2e} to {max(creeps):.2e} m/s under half its strength, at every step alike; the exact law and the replay "
        f"stick ({max(sticks):.0e} and {max(replay_slips):.0e} m/s).",
        at_most("slip of the exact law where it must stick", max(sticks), 1e-12, "m/s", reason="stiction: rounding only"),
        at_most(
            "slip of the replay where it must stick", max(replay_slips), 1e-9, "m/s", reason="true stiction, to the replay's own error"
        ),
        at_least(
            "creep of regularised friction, smallest",
            min(creeps),
            1e-6,
            "m/s",
            reason="a smooth law has no force without slip: it is measured, not hidden",
        ),
        at_most(
            "largest creep against its closed form, relative",
            abs(max(creeps) / (2.0 * 0.1 / sharpness(EPS) * math.atanh(SHARE)) - 1.0),
            0.01,
            reason="tanh(b s/(2 s0)) is the share of the strength that is asked, s0 = 0.1 m/s; what is left of the start decays",
        ),
        at_most("creep at h/16 against h/8, relative", settled, 0.02, reason="a property of the law, not of the grid"),
        at_most("slip above the limit against its closed form, relative", max(slipping), 1e-9, reason="constant forces"),
        charts=(
            chart(
                "Creep of regularised friction against its coefficient",
                x=("coefficient mu", ""),
                y=("creep speed", "m/s"),
                series={"regularised, eps 1e-3, h = 0.02 s": (COEFFICIENTS, creeps)},
                log_x=True,
                words="The exact law and the replay stick: they would lie at zero.",
            ),
            chart(
                "Creep against the step",
                x=("step h", "s"),
                y=("creep speed", "m/s"),
                series={f"mu = {mu:g}": (STEPS, values) for mu, values in by_step.items()},
                log_x=True,
                log_y=True,
                words="It does not vanish as the step goes to zero.",
            ),
        ),
    )


CASE = StressCase(
    title="Stick-slip: mu sweep, h to 0",
    expected="Dry friction sticks; the creep of regularised friction is measured.",
    scenes=("transport",),
)
