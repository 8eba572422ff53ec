"""Local search over contact windows: the first neighbour that is cheaper is taken, until there is none.

Long strides first, halved whenever no shift helps; with a stride of one step windows are also merged, dropped, split and added. A move
that helped is tried again at once. The search knows its problem by one question: is there a plan with these modes below this cost?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from formulations.windows.moves import Move, closed_of, rearrangements, shifts, windows_of

# A neighbour counts as cheaper by this part of the cost: well above the rounding of a solve (1e-13), far below what a step of a window costs.
GAIN = 1e-10


class Candidate(Protocol):
    """A plan that is optimal for its modes."""

    @property
    def closed(self) -> np.ndarray: ...
    @property
    def cost(self) -> float: ...
    @property
    def phi(self) -> np.ndarray: ...


Answer = TypeVar("Answer", bound=Candidate)
Improve = Callable[[np.ndarray, Answer], "Answer | None"]  # (modes, best so far) -> its optimum if that is cheaper than the best, else None


@dataclass(frozen=True, kw_only=True)
class Found(Generic[Answer]):
    """best: the cheapest; tried: neighbours solved; complete: no neighbour is cheaper (False: stopped before that was known)."""

    best: Answer
    tried: int
    complete: bool


def search_windows(best: Answer, improve: Improve, *, stride: int, is_over: Callable[[], bool]) -> Found[Answer]:
    """From `best` downhill. stride: the first stride in steps; is_over: whether to stop."""
    steps = len(best.closed)
    seen = {best.closed.tobytes()}
    tried = 0

    def step(move: Move) -> bool:
        nonlocal best, tried
        moved = move.apply(windows_of(best.closed), steps)
        if moved is None:
            return False
        closed = closed_of(moved, steps)
        closed[0] = best.closed[0]  # the start decides the modes of the first step
        if closed.tobytes() in seen:
            return False
        seen.add(closed.tobytes())
        tried += 1
        found = improve(closed, best)
        if found is None:
            return False
        best = found
        return True

    while True:
        windows, helped = windows_of(best.closed), False
        moves = [*shifts(windows, stride), *(rearrangements(windows, best.phi) if stride == 1 else ())]
        for move in moves:
            if is_over():
                return Found(best=best, tried=tried, complete=False)
            while step(move):
                helped = True
        if not helped and stride == 1:
            return Found(best=best, tried=tried, complete=True)
        stride = stride if helped else max(1, stride // 2)
