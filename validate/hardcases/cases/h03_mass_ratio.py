"""Mass ratios from 1e-4 to 1e4: contact time by its closed form, momentum to rounding, in the replay; and what such a pair costs to simulate."""

from __future__ import annotations

import math

import numpy as np

from models.catalog import load_scene
from validate.hardcases.case import Chart, Finding, HardCase, Series, at_most, none_of
from validate.hardcases.motion import replayed, rolled

RATIOS = tuple(10.0**power for power in range(-4, 5))


def measure() -> Finding:
    base = load_scene("two_body_collision")
    times, momenta, plan_momenta, seconds, wrong = [], [], [], [], []
    for ratio in RATIOS:
        scene = base.with_parameters(m1=1.0, m2=ratio)
        values = {parameter.name: parameter.value for parameter in scene.parameters}
        plan = rolled(scene)
        told = replayed(scene, plan, like=base)
        if not told.ok:
            wrong.append(f"{ratio:g}: {told.message}")
            continue
        closing, opening = (next(event.time for event in told.events if event.closes is closes) for closes in (True, False))
        exact = math.pi * math.sqrt(ratio / (1.0 + ratio) / values["k"])
        times.append(abs((opening - closing) / exact - 1.0))
        masses = np.array([1.0, ratio])
        size = float((masses * np.abs(scene.task.start[2:])).sum())
        momenta.append(float(np.ptp(told.v @ masses)) / size)
        plan_momenta.append(float(np.ptp(plan.v @ masses)) / size)
        seconds.append(told.seconds_reference)
    return Finding(
        happened=f"Contact times are right to {max(times, default=math.nan):.1e}, momentum is kept to {max(momenta, default=math.nan):.1e} of what there is.",
        figures=(
            none_of("ratios whose replay did not reach the end", wrong, reason="each can be simulated"),
            at_most(
                "relative error of the contact time",
                max(times, default=math.nan),
                1e-8,
                reason="half a period of the reduced mass; located to rounding of the clock, 1e-13 s of 0.7 ms",
            ),
            at_most("momentum of the replay", max(momenta, default=math.nan), 1e-12, reason="contact is an inner force"),
            at_most("momentum of the plan's time step", max(plan_momenta, default=math.nan), 1e-12, reason="contact is an inner force"),
        ),
        charts=(
            Chart(
                title="Errors against mass ratio",
                x=("mass ratio", ""),
                y=("relative error", ""),
                series=(
                    Series(name="contact time", x=RATIOS, y=times),
                    Series(name="momentum of the replay", x=RATIOS, y=momenta),
                    Series(name="momentum of the plan", x=RATIOS, y=plan_momenta),
                ),
                log_x=True,
                log_y=True,
            ),
            Chart(
                title="Cost of the reference replay against mass ratio",
                x=("mass ratio", ""),
                y=("seconds", "s"),
                series=(Series(name="two tolerances", x=RATIOS, y=seconds),),
                log_x=True,
            ),
        ),
    )


CASE = HardCase(
    name="h03_mass_ratio",
    title="Mass ratio 1e-4 .. 1e4",
    expected="Contact time and momentum are right at every ratio.",
    scenes=("two_body_collision",),
    measure=measure,
)
