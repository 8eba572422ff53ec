"""How deep the contacts of a replay go, between its rows too.

A penetration lies below its tangents at two rows, as contact only turns it back: every piece of the
replay's grid that could hold the deepest place is run once more, in small steps of the compiled
kernel, as many as it takes.
"""

from __future__ import annotations

import numpy as np

from models import collocation
from models.scene import Scene
from validate.judge.score.evidence import Evidence

# Small steps of a piece of the replay: at first, and at most; and what twice as many change of a
# depth where they are enough.
_FEWEST = 250
_MOST = 512_000
_DEEP = 1e-6


def deepest(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Largest penetration of the replay, (nc,) [m], of a scene between its rows too, and how well its small steps there tell it, (nc,) [m].

    Raises Unmeasured without a whole replay.
    """
    gap, replay = case.replay_gap, case.replay
    depth, unsure = np.maximum(-gap.min(axis=0, initial=0.0), 0.0), np.zeros(gap.shape[1])
    if not isinstance(case.scene, Scene) or len(gap) < 2:
        return depth, unsure
    between = _depth_bounds(
        case.duration, -gap, collocation.penetration_rates(case.kernel, replay.q, replay.v)
    )
    for contact in range(case.scene.nc):
        looked_at: dict[
            int, float
        ] = {}  # every piece that could be deeper than the deepest that the motion was run in once more
        while (
            between[:, contact].max() > depth[contact]
            and (piece := int(between[:, contact].argmax())) not in looked_at
        ):
            between[piece, contact], looked_at[piece] = _depth_within(case, piece, contact)
        depth[contact] = max(depth[contact], between[:, contact].max())
        unsure[contact] = max(looked_at.values(), default=0.0)
    return depth, unsure


def _depth_within(case: Evidence, piece: int, contact: int) -> tuple[float, float]:
    """Largest penetration along a piece of the replay's grid, and what twice as many parts changed of it [m]: a contact may be far shorter than the piece."""
    found, change, parts = np.nan, np.nan, _FEWEST
    while parts <= _MOST and not change <= max(
        case.error.gap, _DEEP * found
    ):  # not a number has not settled either
        before, found = found, float(penetrations_within(case, piece, parts)[:, contact].max())
        # No point twice: one that a hard contact has not turned back yet would be too deep in both.
        change, parts = abs(found - before), 2 * parts + 1
    return (found, change) if np.isfinite(found) else (np.inf, np.inf)


def penetrations_within(case: Evidence, piece: int, parts: int) -> np.ndarray:
    """(parts + 1, nc) along a piece of the replay's grid, in small steps from its first row [m]."""
    replay, held, step = case.replay, case.held_inputs, case.step_of[piece]
    h = float(case.duration[piece]) / parts
    values = (held.values if replay.applied is None else replay.applied)[step]
    late = replay.t[piece] - case.trajectory.t[step] + h * (np.arange(parts) + 0.5)
    u, q, v = values + held.slopes[step] * late[:, None], replay.q[piece], replay.v[piece]
    # Half a step back the velocities of semi-implicit Euler are those of the leapfrog: of second
    # order.
    forces = np.concatenate([replay.lam[piece], replay.friction[piece]])
    v = v - h / 2.0 * case.kernel.acceleration(q[None], v[None], u[:1], forces[None])[0]
    return case.kernel.penetration(case.kernel.rollout(np.concatenate([q, v]), u, h).q)


def _depth_bounds(h: np.ndarray, depth: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """What no penetration between two rows exceeds: a contact only turns it back, so that it lies below its tangents at both rows.

    All but that contact may press it on, by no more than twice what any piece has in the mean.

    Parameters
    ----------
    h : (n-1,) durations of the pieces [s].
    depth, rate : (n, nc) penetrations at the rows [m], and their rates [m/s].

    Returns
    -------
    (n-1, nc) [m]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    h, gains = h[:, None], np.diff(rate, axis=0)
    pressed = (gains / np.maximum(h, 1e-3 * h.max())).max(
        axis=0
    )  # of the shortest pieces rates differ by rounding
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
