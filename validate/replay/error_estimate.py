"""How wrong a replay may be, from four simulations of the same thing."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from validate.replay.result import Difference, ReplayError

# The everyday replay is explained by its own step error if it is within this factor of its step halving: to first order the
# finer run is as far from the truth as the two runs are from each other, and an event within a step makes that vary.
_EXPLAINED = 3.0


class AtNodes(Protocol):
    """A simulation at the plan's nodes: q, v (nodes, nq), gap (nodes, nc)."""

    q: np.ndarray
    v: np.ndarray
    gap: np.ndarray


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
) -> ReplayError:
    """The error of the judged trajectory by the rule that `ReplayError` states."""
    if not has_reference:
        return ReplayError(estimate=step, step=step, step_ratio=ratio)
    judged = tolerance
    if tolerance is not None and step is not None and everyday is not None:
        judged = Difference(
            position=_judged(tolerance.position, step.position, everyday.position),
            state=_judged(tolerance.state, step.state, everyday.state),
            gap=_judged(tolerance.gap, step.gap, everyday.gap),
        )
    return ReplayError(estimate=judged, tolerance=tolerance, step=step, everyday=everyday, step_ratio=ratio)


def _judged(tolerance: float, step: float, everyday: float) -> float:
    return tolerance if everyday <= _EXPLAINED * (step + tolerance) else max(tolerance, everyday)
