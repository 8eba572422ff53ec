"""When to stop descending, judged by the losses alone, whatever their scale and whatever the learning rate.

The last quarter of the iterations (at least 50) is the window. It grows with the iterations because a learning rate ten times
smaller needs ten times the iterations for the same way: a window of fixed length would call a slow descent finished.

    settled      the best loss fell by less than `tolerance` (relative) over the window, or is down to rounding
    runaway      the loss stayed above twice its best over half a window: it climbs instead of descending

The rule itself runs within the compiled loop (`loss_progress` in loss.c); here is what it goes by, for the words at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_SHORTEST_WINDOW = 50
_WINDOW_SHARE = 4
# A loss this far below the first one has lost all digits that the goal was given in.
_NOTHING_LEFT = 1e-20


@dataclass(frozen=True, kw_only=True, eq=False)
class Losses:
    """values (n,): the loss before each iteration, and at the end."""

    values: np.ndarray

    @property
    def first(self) -> float:
        return float(self.values[0])

    @property
    def last(self) -> float:
        return float(self.values[-1])

    @property
    def window(self) -> int:
        """Length of the window [iterations]."""
        return max(_SHORTEST_WINDOW, len(self.values) // _WINDOW_SHARE)

    @property
    def best(self) -> float:
        return float(self.values.min())

    @property
    def exhausted(self) -> bool:
        """Whether the best loss is down to rounding."""
        return self.best <= _NOTHING_LEFT * self.first

    def decrease(self) -> float:
        """Relative decrease of the best loss over the window."""
        earlier = float(self.values[: max(1, len(self.values) - self.window)].min())
        return (earlier - self.best) / earlier if earlier > 0.0 else 0.0
