"""Default limits for scenes that set none, the same for the planner and the judge.

limit_of(scene, "feedback_share")      # the scene's, else the default; None if waived
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np


class Limited(Protocol):
    """A scene or the map of an FMU: its coordinates and its own limits."""

    @property
    def coordinates(self) -> Sequence[Any]:
        """Return the coordinates; each has a `nominal`."""
        ...

    def limit(self, metric: str, /) -> Any:
        """Return the limit of a metric, None if not set. Raises nothing."""
        ...


# Largest deviation of the replay from the plan, in nominals.
REPLAY_ERROR = 1e-2
# Root mean square of the feedback, as a share of half the range of the inputs.
FEEDBACK_EFFORT = 0.25
# Root mean square of the feedback, as a share of the plan's inputs, both averaged over windows.
FEEDBACK_SHARE = 0.25
# Largest difference of contact impulse between plan and replay, as a share of `impulse_yardstick`.
IMPULSE = 0.01


def replay_limits(scene: Limited) -> np.ndarray:
    """Return the largest deviation of each position of the replay, (nq,) [m or rad].

    Infinite if it is waived. Raises nothing.
    """
    own, nominals = scene.limit("replay_error"), [item.nominal for item in scene.coordinates]
    if own is None:
        return REPLAY_ERROR * np.array(nominals)
    return np.full(len(nominals), np.inf if own.value is None else own.value)


def limit_of(scene: Limited, metric: str) -> float | None:
    """Return the limit of a metric: the scene's, else the default; None if waived or not set."""
    own = scene.limit(metric)
    if own is not None:
        return own.value
    return {"feedback_effort": FEEDBACK_EFFORT, "feedback_share": FEEDBACK_SHARE}.get(metric)
