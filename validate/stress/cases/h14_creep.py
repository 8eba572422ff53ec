"""Creep: a block on a ramp at half of the largest friction, for several mu and steps.

Dry friction sticks; regularised friction creeps at every step size. Above the limit the block slips
at the known acceleration.
"""

from __future__ import annotations

import math

import numpy as np

from models.contact_law import ContactLaw, sharpness
from validate.stress.case import Found, StressCase, at_least, at_most, chart, finding
from validate.stress.motion import of_truth, rolled, wrong_by
from validate.truth.problems import creep, ramp

COEFFICIENTS = (0.05, 0.1, 0.2, 0.4, 0.8)
STEPS = (0.01, 0.005, 0.0025, 0.00125, 0.000625)
EPS = 1e-3
SHARE = 0.5
STEEP = 4.0


def _slip_speed(mu: float, step: float) -> float:
    """Return the final slip of the relaxed law [m/s], started at its own height above the plane."""
    problem = creep(mu)
    b = sharpness(EPS, problem.scene.length)
    _, lies, *_ = problem.scene.task.start
    assert lies is not None
    start = (0.0, -math.log(math.expm1(-b * lies)) / b, 0.0, 0.0)
    steps = round(problem.duration / step)
    return float(
        abs(
            rolled(
                problem.scene, start=start, step=step, steps=steps, law=ContactLaw.SOFTPLUS, eps=EPS
            ).v[-1, 0]
        )
    )


def measure() -> Found:
    """Measure the case."""
    creeps, sticks, replay_slips, slipping = [], [], [], []
    like = creep(COEFFICIENTS[0]).scene
    for mu in COEFFICIENTS:
        creeps.append(_slip_speed(mu, STEPS[0]))
        stuck, motion = of_truth(creep(mu), like)
        sticks.append(float(np.abs(stuck.v[:, 0]).max()))
        replay_slips.append(float(np.abs(motion.v[:, 0]).max()) if motion.ok else np.inf)
        slides = ramp(mu, STEEP)
        slipping.append(max(wrong_by(slides, of_truth(slides, like)[1]).values()))
    by_step = {mu: [_slip_speed(mu, h) for h in STEPS] for mu in (0.05, 0.2, 0.8)}
    settled = max(abs(values[-1] / values[-2] - 1.0) for values in by_step.values())
    return finding(
        f"Regularised friction creeps at {min(creeps):.2e} to {max(creeps):.2e} m/s under half its strength, at every step alike; the exact law and the replay "
        f"stick ({max(sticks):.0e} and {max(replay_slips):.0e} m/s).",
        at_most(
            "slip of the exact law where it must stick",
            max(sticks),
            1e-12,
            "m/s",
            reason="stiction: rounding only",
        ),
        at_most(
            "slip of the replay where it must stick",
            max(replay_slips),
            1e-9,
            "m/s",
            reason="true stiction, to the replay's own error",
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
        at_most(
            "creep at h/16 against h/8, relative",
            settled,
            0.02,
            reason="a property of the law, not of the grid",
        ),
        at_most(
            "motion above the limit against its closed form, relative",
            max(slipping),
            1e-9,
            reason="constant forces",
        ),
        charts=(
            chart(
                "Creep of regularised friction against its coefficient",
                x=("coefficient mu", ""),
                y=("creep speed", "m/s"),
                series={"regularised, eps 1e-3, h = 0.01 s": (COEFFICIENTS, creeps)},
                log="x",
                words="The exact law and the replay stick: they would lie at zero.",
            ),
            chart(
                "Creep against the step",
                x=("step h", "s"),
                y=("creep speed", "m/s"),
                series={f"mu = {mu:g}": (STEPS, values) for mu, values in by_step.items()},
                log="xy",
                words="It does not vanish as the step goes to zero.",
            ),
        ),
    )


CASE = StressCase(
    title="Stick-slip: mu sweep, h to 0",
    expected="Dry friction sticks; the creep of regularised friction is measured.",
)
