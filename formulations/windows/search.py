"""A local search over contact windows: the first neighbour that is cheaper is taken, until there is none.

Where a pair touches and its multiplier pulls the wrong way, the other mode is cheaper to first order: such pairs are switched before anything
is tried. Then long strides, halved whenever no shift helps. Between the longest stride and the others windows are repeated (a second push costs
less than one twice as strong): none of the small moves gets there. With a stride of one step windows are also merged, dropped, split and
added. A move that helped is tried again at once. The search knows its problem by one question: is there a plan with these modes below this cost?
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from formulations.windows.moves import Move, closed_of, rearrangements, repetitions, shifts, windows_of

# A neighbour counts as cheaper by this part of the cost: well above the rounding of a solve (1e-13), far below what a step of a window costs.
GAIN = 1e-10
_PULL = 1e-6  # a multiplier [cost per N] that is clearly not zero


class Candidate(Protocol):
    """A plan that is optimal for its modes."""

    @property
    def closed(self) -> np.ndarray: ...
    @property
    def cost(self) -> float: ...
    @property
    def phi(self) -> np.ndarray: ...
    @property
    def pull(self) -> np.ndarray:
        """(steps, nc), negative where a touching pair would rather be in its other mode."""
        ...


Answer = TypeVar("Answer", bound=Candidate)
Improve = Callable[[np.ndarray, Answer], Answer | None]  # (modes, best so far) -> its optimum if that is cheaper than the best, else None


@dataclass(frozen=True, kw_only=True)
class Found(Generic[Answer]):
    """best: the cheapest; tried: neighbours solved; complete: no neighbour is cheaper (False: stopped before that was known)."""

    best: Answer
    tried: int
    complete: bool


def search_windows(best: Answer, improve: Improve[Answer], *, stride: int, is_over: Callable[[], bool]) -> Found[Answer]:
    """From `best` downhill. stride: the first stride in steps; is_over: whether to stop."""
    return _Search(best, improve, is_over).run(stride)


class _Search(Generic[Answer]):
    def __init__(self, best: Answer, improve: Improve[Answer], is_over: Callable[[], bool]) -> None:
        self._best, self._improve, self._is_over = best, improve, is_over
        self._steps, self._tried = len(best.closed), 0
        self._seen = {best.closed.tobytes()}

    def run(self, stride: int) -> Found[Answer]:
        longest, repeated = stride, False
        while not self._is_over():
            self._follow_pulls()
            helped = self._any(shifts(windows_of(self._best.closed), stride))
            if not helped and stride == 1:
                helped = self._any(rearrangements(windows_of(self._best.closed), self._best.phi))
            if not helped and not repeated:
                repeated = not self._repeat()
                helped, stride = not repeated, longest
            if self._is_over():
                break
            if not helped and stride == 1:
                return Found(best=self._best, tried=self._tried, complete=True)
            stride = stride if helped else max(1, stride // 2)
        return Found(best=self._best, tried=self._tried, complete=False)

    def _any(self, moves: Iterable[Move]) -> bool:
        """Whether one of the moves helped; each is tried for as long as it does."""
        helped = False
        for move in moves:
            while not self._is_over() and self._step(move):
                helped = True
        return helped

    def _step(self, move: Move) -> bool:
        moved = move.apply(windows_of(self._best.closed), self._steps)
        return moved is not None and self._take(closed_of(moved, self._steps))

    def _repeat(self) -> bool:
        """The cheapest of the plans with one window repeated, if it is cheaper."""
        begin, windows = self._best, windows_of(self._best.closed)
        for move in repetitions(windows, self._steps):
            moved = move.apply(windows, self._steps)
            if moved is not None and not self._is_over():
                self._take(closed_of(moved, self._steps))
        return self._best is not begin

    def _follow_pulls(self) -> None:
        """Switch the pairs that would rather be in their other mode: all of them, else half, a quarter .. of them, those that pull most."""
        while not self._is_over():
            pull = self._best.pull
            order = np.argsort(pull, axis=None)[: int((pull < -_PULL).sum())]
            count = len(order)
            while count:
                closed = self._best.closed.copy()
                closed.reshape(-1)[order[:count]] ^= True
                if self._take(closed):
                    break
                count //= 2
            if not count:
                return

    def _take(self, closed: np.ndarray) -> bool:
        closed[0] = self._best.closed[0]  # the start decides the modes of the first step
        if closed.tobytes() in self._seen:
            return False
        self._seen.add(closed.tobytes())
        self._tried += 1
        found = self._improve(closed, self._best)
        if found is None:
            return False
        self._best = found
        return True
