"""Deepest penetrations of a replay, between its rows too.

A penetration lies below its tangents at two rows, because contact reduces its rate. Pieces that may
be deepest are repeated in small steps of the compiled kernel.
"""

from __future__ import annotations

import numpy as np

from models import collocation
from models.scene import Scene
from validate.judge.score.evidence import Evidence

_FEWEST = 250
_MOST = 512_000
# Relative change of a depth, on doubling the steps, that ends the refinement.
_DEEP = 1e-6


def deepest(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest penetrations of the replay and their errors, (nc,) [m] each.

    Raises Unmeasured without a finished replay.
    """
    gap, replay = case.replay_gap, case.replay
    depth, unsure = np.maximum(-gap.min(axis=0, initial=0.0), 0.0), np.zeros(gap.shape[1])
    if not isinstance(case.scene, Scene) or len(gap) < 2:
        return depth, unsure
    between = _depth_bounds(
        case.duration, -gap, collocation.penetration_rates(case.kernel, replay.q, replay.v)
    )
    for contact in range(case.scene.nc):
        looked_at: dict[int, float] = {}
        while (
            between[:, contact].max() > depth[contact]
            and (piece := int(between[:, contact].argmax())) not in looked_at
        ):
            between[piece, contact], looked_at[piece] = _depth_within(case, piece, contact)
        depth[contact] = max(depth[contact], between[:, contact].max())
        unsure[contact] = max(looked_at.values(), default=0.0)
    return depth, unsure


def _depth_within(case: Evidence, piece: int, contact: int) -> tuple[float, float]:
    """Return the largest penetration in a piece, and its change on doubling the steps [m]."""
    depth, change, parts = np.nan, np.nan, _FEWEST
    while parts <= _MOST and not change <= max(case.error.gap, _DEEP * depth):  # true for NaN too
        before, depth = depth, float(penetrations_within(case, piece, parts)[:, contact].max())
        # No point is used twice: before a hard contact acts, both would be too deep.
        change, parts = abs(depth - before), 2 * parts + 1
    return (depth, change) if np.isfinite(depth) else (np.inf, np.inf)


def penetrations_within(case: Evidence, piece: int, parts: int) -> np.ndarray:
    """Return penetrations (parts + 1, nc) [m] along a piece, in small steps from its first row.

    Raises Unmeasured without a finished replay.
    """
    replay, held, step = case.replay, case.held_inputs, case.step_of[piece]
    h = float(case.duration[piece]) / parts
    values = (held.values if replay.applied is None else replay.applied)[step]
    late = replay.t[piece] - case.trajectory.t[step] + h * (np.arange(parts) + 0.5)
    u, q, v = values + held.slopes[step] * late[:, None], replay.q[piece], replay.v[piece]
    # Velocities half a step back make semi-implicit Euler a leapfrog, of second order.
    forces = np.concatenate([replay.lam[piece], replay.friction[piece]])
    v = v - h / 2.0 * case.kernel.acceleration(q[None], v[None], u[:1], forces[None])[0]
    return case.kernel.penetration(case.kernel.rollout(np.concatenate([q, v]), u, h).q)


def _depth_bounds(h: np.ndarray, depth: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return upper bounds (n-1, nc) [m] of the penetrations between rows, by their tangents.

    Other forces press by at most twice their largest mean. h: (n-1,) [s]; depth, rate: (n, nc) [m],
    [m/s]. Raises ValueError if the shapes do not fit.
    """
    h, gains = h[:, None], np.diff(rate, axis=0)
    pressed = (gains / np.maximum(h, 1e-3 * h.max())).max(
        axis=0
    )  # rates of the shortest pieces differ by rounding
    bend = 2.0 * np.maximum(np.maximum(pressed * h, gains), 0.0)  # their acceleration times h
    first, last = rate[:-1] + bend / 2.0, rate[1:] - bend / 2.0
    share = np.divide(
        np.diff(depth, axis=0) - last * h,
        (first - last) * h,
        out=np.zeros_like(gains),
        where=(first - last) * h > 0.0,
    )
    return np.maximum(
        np.maximum(depth[:-1], depth[1:]), depth[:-1] + np.clip(share, 0.0, 1.0) * first * h
    )
