"""The limits where a scene sets none, one set for the planner and the judge.

limit_of(scene, "feedback_share")      # the scene's, else the default; None if waived
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from models.scene import Scene

# Largest deviation of the replay from the plan, in nominals.
REPLAY_ERROR = 1e-2
# Root mean square of the feedback, as a share of half the range of the inputs.
FEEDBACK_EFFORT = 0.25
# The same as a share of the plan's own inputs, both averaged over windows.
FEEDBACK_SHARE = 0.25
# Windows in a plan: shorter dither of the inputs moves nothing and counts for nothing.
WINDOWS = 50


def replay_limits(scene: Scene) -> np.ndarray:
    """Return the largest deviation of each position of the replay, (nq,) [m or rad]; infinite if waived."""
    own, nominals = scene.limit("replay_error"), [item.nominal for item in scene.coordinates]
    if own is None:
        return REPLAY_ERROR * np.array(nominals)
    return np.full(len(nominals), np.inf if own.value is None else own.value)


def limit_of(scene: Scene, metric: str) -> float | None:
    """Return the limit of one number: the scene's, else the default; None if waived or not set."""
    own = scene.limit(metric)
    if own is not None:
        return own.value
    return {"feedback_effort": FEEDBACK_EFFORT, "feedback_share": FEEDBACK_SHARE}.get(metric)


def input_share(
    t: np.ndarray, added: np.ndarray, own: np.ndarray, scale: np.ndarray
) -> float | None:
    """Return the share of feedback in the inputs, as root mean squares of averages over windows.

    Parameters
    ----------
    t
        Times (steps + 1,) of the steps [s].
    added, own
        Means over each step (steps, nu) of the feedback and of the plan's inputs [N, N m].
    scale
        Half the range of each input (nu,) [N, N m].

    Returns
    -------
    float | None
        [-]; None if the plan's own inputs are zero and the feedback is not.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    edges = np.linspace(t[0], t[-1], WINDOWS + 1)
    sizes = []
    for values in (added, own):
        sums = np.vstack([np.zeros(len(scale)), np.cumsum(np.diff(t)[:, None] * values, axis=0)])
        means = [np.diff(np.interp(edges, t, column)) for column in sums.T]
        sizes.append(float(np.linalg.norm(np.array(means) / scale[:, None])))
    if sizes[1] > 0.0:
        return sizes[0] / sizes[1]
    return None if sizes[0] > 0.0 else 0.0
