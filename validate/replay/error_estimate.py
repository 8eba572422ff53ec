"""How wrong a replay may be, from simulations of the same thing, and from steps made twice."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from validate.replay.result import Difference, ReplayError, StepSource

# The everyday replay is explained by its own step error if it is within this factor of its step halving: to first order the
# finer run is as far from the truth as the two runs are from each other, and an event within a step makes that vary.
_EXPLAINED = 3.0


class AtNodes(Protocol):
    """A simulation at the plan's nodes: q, v (nodes, nq), gap (nodes, nc)."""

    q: np.ndarray
    v: np.ndarray
    gap: np.ndarray


# By whether there is a second run, and a rollback.
_SOURCES: dict[tuple[bool, bool], StepSource] = {
    (False, False): "none",
    (True, False): "second run",
    (False, True): "rollback",
    (True, True): "second run and rollback",
}
# The same where the author states an accuracy too.
_STATED: dict[StepSource, StepSource] = {
    "none": "stated",
    "second run": "second run, stated",
    "rollback": "rollback, stated",
    "second run and rollback": "second run and rollback, stated",
}


def difference(one: AtNodes | None, other: AtNodes | None) -> Difference | None:
    """Largest difference over the nodes, or None if one of the two did not get to the end."""
    if one is None or other is None:
        return None
    state = np.hypot(np.linalg.norm(one.q - other.q, axis=1), np.linalg.norm(one.v - other.v, axis=1))
    return Difference(
        position=float(np.abs(one.q - other.q).max()), state=float(state.max()), gap=float(np.abs(one.gap - other.gap).max(initial=0.0))
    )


# Below this position difference [m or rad] a ratio is one of roundings.
_ROUNDING = 1e-11
# Two runs that differ by less than this share of the motion are the same run.
_SAME = 1e-13


def heeds_step(coarse: AtNodes | None, fine: AtNodes | None) -> bool:
    """Whether half the communication step changes anything. If not, the FMU has a step of its own, and what is wrong with that one does not show."""
    if coarse is None or fine is None:
        return True
    one, other = np.hstack([coarse.q, coarse.v]), np.hstack([fine.q, fine.v])
    return bool((np.abs(one - other) > _SAME * np.abs(other).max(initial=0.0)).any())


def local_errors(fine: AtNodes | None, coarse_steps: AtNodes | None, times: np.ndarray, carried: bool, heeds: bool) -> Difference | None:
    """What halving each step changed in that step, summed over the steps; None without a rollback, or if half the step changes nothing and it is not
    known that the FMU `heeds` its step.

    coarse_steps: where each coarse step ended (steps, ...), from the fine run's node (nodes, ...) before it; times (nodes,) [s].
    carried: an error of velocity goes on as one of position until the end, dq/dt = v. That overstates (bouncing_mass: 12 times the error of the
    coarser run, three_cart 4 times), the sum alone understates (0.4 to 0.6 times): forces turn an error of velocity round.
    """
    if fine is None or coarse_steps is None:
        return None
    q, v, gap = (np.abs(getattr(fine, name)[1:] - getattr(coarse_steps, name)) for name in ("q", "v", "gap"))
    motion = np.abs(np.hstack([fine.q, fine.v]))
    if not heeds and not (np.hstack([q, v]) > _SAME * motion.max(initial=0.0)).any():
        return None
    position, velocity = q.sum(axis=0), v.sum(axis=0)
    moved = gap.sum(axis=0)
    if carried and q.shape == v.shape:
        drift = (times[-1] - times[1:]) @ v
        position = position + drift
        moved = moved + 2.0 * drift.max(initial=0.0)  # two bodies may come towards each other
    return Difference(
        position=float(position.max(initial=0.0)),
        state=float(np.hypot(np.linalg.norm(position), np.linalg.norm(velocity))),
        gap=float(moved.max(initial=0.0)),
    )


def larger(one: Difference | None, other: Difference | None) -> Difference | None:
    """Entry by entry, or the one there is."""
    if one is None or other is None:
        return other if one is None else one
    return Difference(position=max(one.position, other.position), state=max(one.state, other.state), gap=max(one.gap, other.gap))


def _larger_where_stated(measured: Difference, stated: Difference) -> Difference:
    """Entry by entry; what the runs say where nothing is stated."""
    return Difference(
        position=max(measured.position, stated.position) if math.isfinite(stated.position) else measured.position,
        state=max(measured.state, stated.state) if math.isfinite(stated.state) else measured.state,
        gap=max(measured.gap, stated.gap) if math.isfinite(stated.gap) else measured.gap,
    )


def step_ratio(before: Difference | None, after: Difference | None) -> float | None:
    """Position difference of one step halving over that of the next; None where there is none to speak of."""
    if before is None or after is None or after.position < _ROUNDING:
        return None
    return before.position / after.position


def estimate(
    *,
    tolerance: Difference | None,
    step: Difference | None,
    everyday: Difference | None,
    has_reference: bool,
    ratio: float | None = None,
    rollback: Difference | None = None,
    stated: Difference | None = None,
) -> ReplayError:
    """The error of the judged trajectory by the rule that `ReplayError` states."""
    source = _SOURCES[step is not None, rollback is not None]
    if not has_reference:
        measured = larger(step, rollback)
        if stated is not None:
            source = _STATED[source]
            measured = stated if measured is None else _larger_where_stated(measured, stated)
        return ReplayError(estimate=measured, step=step, step_ratio=ratio, rollback=rollback, step_source=source, stated=stated)
    # Where the looser reference did not get to the end, the everyday replay - another method - is as far away as the judged run may be wrong.
    judged = tolerance if tolerance is not None or step is None else larger(everyday, step) if everyday is not None else None
    if tolerance is not None and step is not None and everyday is not None:
        judged = Difference(
            position=_judged(tolerance.position, step.position, everyday.position),
            state=_judged(tolerance.state, step.state, everyday.state),
            gap=_judged(tolerance.gap, step.gap, everyday.gap),
        )
    return ReplayError(
        estimate=judged, tolerance=tolerance, step=step, everyday=everyday, step_ratio=ratio, rollback=rollback, step_source=source
    )


def _judged(tolerance: float, step: float, everyday: float) -> float:
    return tolerance if everyday <= _EXPLAINED * (step + tolerance) else max(tolerance, everyday)
