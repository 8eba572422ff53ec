"""What is left of the relaxation time of a scene without inertia (models.quasi_static), told by a run at twice that time.

The motion is off by tau times its speed, and by what its forces make of that: of first order in tau, so that the run at 2 tau is as far from the judged
one as that is from the first-order model, D v = F.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from models.scene import Scene
from models.trajectory import Trajectory
from validate.isolation import Limits
from validate.replay.error_estimate import difference
from validate.replay.everyday import base_step
from validate.replay.feedback import Feedback
from validate.replay.job import Settings, run_job
from validate.replay.outputs import Outputs
from validate.replay.package import Package
from validate.replay.result import Difference, Replay, ReplayOutcome
from validate.replay.scene_variables import find_variables
from validate.replay.wiring import Variables

# Relaxation times in the longest internal step of the everyday replay. Runge-Kutta 4 is stable below 2.78, and keeps q + tau v whatever its step: at 2 the
# plans of push_box are within 1e-9 m of the reference.
_LAGS_IN_A_STEP = 2.0


def fine_enough(scene: Scene, plan: Trajectory, settings: Settings) -> Settings:
    """Settings whose coarsest everyday run is stable at this relaxation time; as they are for a scene with inertia."""
    if scene.lag is None or not settings.fineness:
        return settings
    wanted = base_step(plan.t) / (_LAGS_IN_A_STEP * scene.lag)
    factor = max(1, math.ceil(wanted / min(settings.fineness)))
    # Two runs tell the error of the step; a third, for its order, would take as long as both.
    return replace(settings, fineness=tuple(factor * fineness for fineness in sorted(settings.fineness)[:2]))


def twice_the_lag(package: Package, scene: Scene, names: Mapping[str, str] | None) -> Variables | None:
    """The FMU's variables with twice the relaxation time; None for a scene with inertia, or an FMU that does not know the time."""
    if scene.lag is None:
        return None
    twice = find_variables(package, scene.continuous(2.0 * scene.lag), names)
    return None if twice == find_variables(package, scene, names) else twice


def with_lag_error(
    scene: Scene,
    package: Package,
    twice: Variables | None,
    plan: Trajectory,
    settings: Settings,
    limits: Limits | None,
    feedback: Feedback | None,
    replayed: Replay,
) -> Replay:
    """The replay with the lag's error in its own; as it is where there is none to be told (`twice_the_lag`)."""
    if twice is None or not replayed.ok:
        return replayed
    is_reference = replayed.method == "reference"
    one = replace(
        settings, tolerances=settings.tolerances[:1] if is_reference else (), fineness=() if is_reference else settings.fineness[-1:]
    )
    simulated = run_job(package, twice, plan, plan.start, one, limits, feedback)
    run = (simulated.reference or simulated.everyday)[-1]
    if run.outcome is not ReplayOutcome.OK:
        note = f"What the relaxation time does is not known: with twice as much, {run.message or run.outcome.value}"
        return replace(replayed, error=replace(replayed.error, estimate=None), message=f"{replayed.message} {note}".lstrip())
    lag, estimate = difference(Outputs(scene, twice, run, run.knots), _Nodes(replayed)), replayed.error.estimate
    both = None if lag is None or estimate is None else _sum(estimate, lag)
    return replace(replayed, error=replace(replayed.error, lag=lag, estimate=both))


class _Nodes:
    """A replay at the plan's nodes."""

    def __init__(self, replay: Replay) -> None:
        self.q, self.v, self.gap = (array[replay.knots] for array in (replay.q, replay.v, replay.gap))


def _sum(one: Difference, other: Difference) -> Difference:
    return Difference(position=one.position + other.position, state=one.state + other.state, gap=one.gap + other.gap)
