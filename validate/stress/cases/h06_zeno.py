"""Zeno-like bouncing on a damped floor: bounces shrink by a ratio, and the replay must end.

With restitution e and first speed v the flights last 2 v/g (e + e^2 + ...). Rest begins at t_1 +
(2 v/g) e/(1 - e), plus contact times. The floor is stiff, so that gravity is negligible in contact.
"""

from __future__ import annotations

import math

import numpy as np

from models.scene.contacts import DampingLaw
from models.scenes import bouncing_mass as drop
from validate.judge.replay import ReplayOutcome
from validate.stress.case import (
    Found,
    StressCase,
    at_least,
    at_most,
    chart,
    finding,
    none_of,
    unlimited,
)
from validate.stress.motion import replayed, rolled
from validate.truth.problems import damped_floor, restitution

STIFFNESS = 1e7
RATIO = 0.2
NODES = 180
STEP = 0.01
# Fewer events than bounces, to exceed the budget.
BUDGET = 6


def measure() -> Found:
    """Measure the case."""
    damping = 2.0 * RATIO * math.sqrt(STIFFNESS * drop.MASS)
    scene = damped_floor(DampingLaw.KELVIN_VOIGT, damping, k=STIFFNESS).with_task(
        step=STEP, steps=NODES
    )
    fine = 20000  # step that the stiff floor needs
    plan = rolled(scene, step=STEP / fine, steps=NODES * fine, every=fine)
    motion = replayed(scene, plan)
    e, first = restitution(RATIO), 2.0 * drop.FALL_TIME
    series = drop.FALL_TIME + first * e / (1.0 - e)
    touches = [
        event for event in motion.events if event.contact == "floor"
    ]  # without releases of the damped force
    opened = [event.time for event in touches if not event.closes]
    closed = [event.time for event in touches if event.closes]
    rest = max(opened + closed, default=math.nan)
    contact = sum(late - early for early, late in zip(closed, opened, strict=False))
    flights = np.array([down - up for up, down in zip(opened, closed[1:], strict=False)])
    ratios = flights[1:] / flights[:-1]
    small = replayed(scene, plan, event_budget=BUDGET)
    wrong = [] if motion.ok else [f"the replay does not end: {motion.message}"]
    if small.outcome is not ReplayOutcome.EVENT_BUDGET or str(BUDGET) not in small.message:
        wrong.append(
            f"a budget of {BUDGET} events is not told: {small.outcome.name.lower()}, {small.message}"
        )
    return finding(
        f"{len(closed)} bounces; at rest after {rest:.4f} s, {contact:.4f} s of it in contact, where the series of flights says {series:.4f} s. With a budget of "
        f"{BUDGET} events: {small.message}",
        none_of(
            "what does not end, or is not told",
            wrong,
            reason="the replay ends, and says so where its budget of events is used up",
        ),
        at_least("bounces", len(closed), 5, reason="a series, not a single bounce"),
        at_most(
            "first flights: share of the one before, off the restitution",
            abs(float(ratios[:3].mean()) / e - 1.0) if len(ratios) > 2 else math.nan,
            0.01,
            reason="gravity acts in contact too: g/(w v) is 1e-3 there",
        ),
        at_most(
            "time of rest against the series, relative",
            abs((rest - contact) / series - 1.0),
            0.02,
            reason="gravity takes 0.2 % of each flight, which makes 0.5 % of their sum; the last ones are as low as the floor sags",
        ),
        unlimited("contact events", len(motion.events)),
        charts=(
            chart(
                "Flights between bounces",
                x=("bounce", ""),
                y=("time of flight", "s"),
                series={
                    "replay": (np.arange(1, len(flights) + 1), flights),
                    "geometric series": (
                        np.arange(1, len(flights) + 1),
                        first * e ** np.arange(1, len(flights) + 1),
                    ),
                },
                log="y",
            ),
        ),
    )


CASE = StressCase(
    title="Zeno-like bouncing",
    expected="It ends; the budget of events is reported; the time of rest is that of the geometric series.",
    scenes=("bouncing_mass",),
)
