"""When to stop descending, judged by the losses alone, whatever their scale and whatever the learning rate.

The last quarter of the iterations (at least 50) is the window. It grows with the iterations because a learning rate ten times
smaller needs ten times the iterations for the same way: a window of fixed length would call a slow descent finished.

    settled      the best loss fell by less than `tolerance` (relative) over the window, or is down to rounding
    runaway      the loss stayed above twice its best over half a window: it climbs instead of descending
"""

from __future__ import annotations

from enum import Enum

_SHORTEST_WINDOW = 50
_WINDOW_SHARE = 4
# A loss this far below the first one has lost all digits that the goal was given in.
_NOTHING_LEFT = 1e-20
_RUNAWAY = 2.0


class Progress(Enum):
    DESCENDING = "descending"
    SETTLED = "settled"
    RUNAWAY = "runaway"


class Losses:
    """values: the loss before each iteration, and at the end."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self._best: list[float] = []  # the least of the first so many

    def add(self, loss: float, tolerance: float) -> Progress:
        """Take the next loss and say how the descent goes."""
        self.values.append(loss)
        self._best.append(min(loss, self._best[-1]) if self._best else loss)
        if self.exhausted:
            return Progress.SETTLED
        if len(self.values) <= self.window:
            return Progress.DESCENDING
        if loss > _RUNAWAY * self.best and min(self.values[-(self.window // 2) :]) > _RUNAWAY * self.best:
            return Progress.RUNAWAY
        return Progress.SETTLED if self.decrease() <= tolerance else Progress.DESCENDING

    @property
    def first(self) -> float:
        return self.values[0]

    @property
    def last(self) -> float:
        return self.values[-1]

    @property
    def window(self) -> int:
        """Length of the window [iterations]."""
        return max(_SHORTEST_WINDOW, len(self.values) // _WINDOW_SHARE)

    @property
    def best(self) -> float:
        return self._best[-1]

    @property
    def exhausted(self) -> bool:
        """Whether the best loss is down to rounding."""
        return self.best <= _NOTHING_LEFT * self.first

    def decrease(self) -> float:
        """Relative decrease of the best loss over the window."""
        earlier = self._best[max(0, len(self._best) - 1 - self.window)]
        return (earlier - self.best) / earlier if earlier > 0.0 else 0.0
