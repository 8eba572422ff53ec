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


class StoppingRule:
    """Fed with one loss an iteration; see the module docstring."""

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.losses: list[float] = []
        self._best: list[float] = []  # best loss up to each iteration

    @property
    def window(self) -> int:
        """Length of the window [iterations]."""
        return max(_SHORTEST_WINDOW, len(self.losses) // _WINDOW_SHARE)

    @property
    def is_best(self) -> bool:
        """Whether the last loss is the best one so far."""
        return self._best[-1] == self.losses[-1]

    @property
    def best(self) -> float:
        return self._best[-1]

    @property
    def exhausted(self) -> bool:
        """Whether the best loss is down to rounding."""
        return self.best <= _NOTHING_LEFT * self.losses[0]

    def decrease(self) -> float:
        """Relative decrease of the best loss over the window."""
        earlier = self._best[max(0, len(self._best) - 1 - self.window)]
        return (earlier - self.best) / earlier if earlier > 0.0 else 0.0

    def add(self, loss: float) -> Progress:
        """Take the next loss and say how the descent goes."""
        self.losses.append(loss)
        self._best.append(min(loss, self._best[-1]) if self._best else loss)
        if self.exhausted:
            return Progress.SETTLED
        if len(self.losses) <= self.window:
            return Progress.DESCENDING
        recent = self.losses[-(self.window // 2) :] if self.losses[-1] > _RUNAWAY * self.best else ()
        if recent and min(recent) > _RUNAWAY * self.best:
            return Progress.RUNAWAY
        return Progress.SETTLED if self.decrease() <= self.tolerance else Progress.DESCENDING
