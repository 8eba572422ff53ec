"""A local search over contact windows: the first neighbour that is cheaper is taken, until there is none.

Where a pair touches and its multiplier pulls the wrong way, the other mode is cheaper to first order: such pairs are switched before anything
is tried. Then windows that are not needed are dropped, and long strides begin, halved whenever no shift helps. Between the longest stride and
the others windows are repeated (a second push costs less than one twice as strong): none of the small moves gets there. With a stride of one
step windows are also merged, dropped, split and added. A move that helped is tried again at once. At last detours: a window is dropped, or two
are merged, although that is dearer, and what is left is shifted for a while; two pushes become one that way, at another time. The search knows
its problem by one question: is there a plan with these modes below this cost?
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from formulations.windows.moves import Move, closed_of, fewer, onwards, rearrangements, repetitions, shifts, windows_of

# A neighbour counts as cheaper by this part of the cost: well above the rounding of a solve (1e-13), far below what a step of a window costs.
GAIN = 1e-10
_PULL = 1e-6  # a multiplier [cost per N] that is clearly not zero
_ALONE = 20  # pairs that are switched one by one where switching them together does not help
_DETOUR = 40  # plans tried on a detour; from two pushes to one, 27 steps away, 20 are enough
_STRETCH = 4  # of the longest stride: the first on a detour


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
Improve = Callable[[np.ndarray, Answer, float], Answer | None]  # (modes, neighbour, below) -> its optimum if that costs less, else None


@dataclass(frozen=True, kw_only=True)
class Found(Generic[Answer]):
    """best: the cheapest; tried: neighbours solved; complete: no neighbour is cheaper (False: stopped before that was known)."""

    best: Answer
    tried: int
    complete: bool


def search_windows(best: Answer, improve: Improve[Answer], *, stride: int, is_over: Callable[[], bool], far: bool = True) -> Found[Answer]:
    """From `best` downhill. stride: the first stride in steps; is_over: whether to stop; far: whether to look further than a move."""
    return _Search(best, improve, is_over).run(stride, far)


def follow_pulls(best: Answer, improve: Improve[Answer], *, is_over: Callable[[], bool]) -> Found[Answer]:
    """Only switch pairs that touch and would rather be in their other mode, until none helps."""
    search = _Search(best, improve, is_over)
    search.follow_pulls()
    return search.found(complete=not is_over())


class _Search(Generic[Answer]):
    def __init__(self, best: Answer, improve: Improve[Answer], is_over: Callable[[], bool], most: float = np.inf) -> None:
        self._best, self._improve, self._time_is_over, self._most = best, improve, is_over, most
        self._steps, self._tried = len(best.closed), 0
        self._seen = {best.closed.tobytes()}

    def _is_over(self) -> bool:
        return self._tried >= self._most or self._time_is_over()

    def found(self, *, complete: bool) -> Found[Answer]:
        return Found(best=self._best, tried=self._tried, complete=complete)

    def run(self, stride: int, far: bool) -> Found[Answer]:
        longest, repeated = stride, not far
        if far:
            self.follow_pulls()
            self._any(fewer(windows_of(self._best.closed)))
        while not self._is_over():
            self.follow_pulls()
            helped = self._any(shifts(windows_of(self._best.closed), stride))
            if not helped and stride == 1:
                helped = self._any(rearrangements(windows_of(self._best.closed), self._best.phi))
            if not helped and not repeated:
                repeated = not self._repeat()
                helped, stride = not repeated, longest
            if not helped and stride == 1 and far and self._detours(longest):
                helped, stride = True, longest
            if self._is_over():
                break
            if not helped and stride == 1:
                return self.found(complete=True)
            stride = stride if helped else max(1, stride // 2)
        return self.found(complete=False)

    def shift(self, stride: int) -> Answer:
        """Only shifts, down to those by one step."""
        while stride and not self._is_over():
            self.follow_pulls()
            stride = stride if self._any(shifts(windows_of(self._best.closed), stride)) else stride // 2
        return self._best

    def _detours(self, stride: int) -> bool:
        """Whether one of the moves to fewer windows, dearer as it may be, leads to a cheaper plan by shifts."""
        begin, windows = self._best, windows_of(self._best.closed)
        for move in fewer(windows):
            moved = move.apply(windows, self._steps)
            if moved is None or self._is_over():
                continue
            self._tried += 1
            start = self._improve(closed_of(moved, self._steps), begin, np.inf)
            if start is None:
                continue
            way = _Search(start, self._improve, self._is_over, _DETOUR)
            end = way.shift(_STRETCH * stride)
            self._tried += way.found(complete=True).tried
            if end.cost < begin.cost - GAIN * abs(begin.cost):
                self._best = end
                return True
        return False

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

    def follow_pulls(self) -> None:
        """Switch the pairs that would rather be in their other mode: all of them, else half, a quarter .. of them, those that pull most, else
        one by one. What helped once is tried again, ever further: every window end as many steps on as it just went."""
        times = 1
        while not self._is_over():
            before, pull = windows_of(self._best.closed), self._best.pull
            order = np.argsort(pull, axis=None)[: int((pull < -_PULL).sum())]
            together = [order[: len(order) >> halvings] for halvings in range(len(order).bit_length())]
            alone = [order[one : one + 1] for one in range(1, min(len(order), _ALONE))]
            if not any(self._switch(pairs) for pairs in (*together, *alone)):
                return
            further = onwards(before, windows_of(self._best.closed), times, self._steps)
            helped = further is not None and not self._is_over() and self._take(closed_of(further, self._steps))
            times = 2 * times if helped else max(1, times // 2)

    def _switch(self, pairs: np.ndarray) -> bool:
        closed = self._best.closed.copy()
        closed.reshape(-1)[pairs] ^= True
        return not self._is_over() and self._take(closed)

    def _take(self, closed: np.ndarray) -> bool:
        closed[0] = self._best.closed[0]  # the start decides the modes of the first step
        if closed.tobytes() in self._seen:
            return False
        self._seen.add(closed.tobytes())
        self._tried += 1
        found = self._improve(closed, self._best, self._best.cost - GAIN * abs(self._best.cost))
        if found is None:
            return False
        self._best = found
        return True
