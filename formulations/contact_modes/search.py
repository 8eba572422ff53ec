"""A local search over contact windows: the first neighbour that is cheaper is taken, until there is none.

Where a pair touches and its multiplier pulls the wrong way, the other mode is cheaper to first order: such pairs are switched before anything
is tried. Then windows that are not needed are dropped, and long strides begin, halved whenever no shift helps. Between the longest stride and
the others windows are repeated (a second push costs less than one twice as strong): none of the small moves gets there. With a stride of one
step windows are also merged, dropped, split and added. A move that helped is tried again at once. At last detours: a window is dropped, or two
are merged, although that is dearer, and what is left is shifted for a while; two pushes become one that way, at another time. The search knows
its problem by one question: is there a plan with these modes below this cost?

Contact windows and the moves between neighbours.

A window (first, stop) is a run of steps first <= t < stop in which a contact is closed; `Windows` holds those of each contact, in order.

    windows = windows_of(closed)                       # closed (steps, nc)
    MoveEnd(contact=0, index=0, end=0, by=-2).apply(windows, steps)     # a window begins two steps earlier

A move that is not possible gives None. `undo(windows)` of a move is the move that takes its result back to `windows`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, Protocol, TypeVar

import numpy as np

Window = tuple[int, int]
Windows = tuple[tuple[Window, ...], ...]

_APART = (0.05, 0.1, 0.15, 0.2, 0.3)  # of the horizon: how far a window is from its repetition
_PLACES = tuple(0.05 * place for place in range(1, 20))  # of the horizon: where a first window of a contact is tried


def windows_of(closed: np.ndarray) -> Windows:
    """The windows of closed (steps, nc)."""
    found = []
    for column in np.asarray(closed, dtype=bool).T:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]])))
        found.append(tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)))
    return tuple(found)


def closed_of(windows: Windows, steps: int) -> np.ndarray:
    """closed (steps, nc) of windows."""
    closed = np.zeros((steps, len(windows)), dtype=bool)
    for contact, row in enumerate(windows):
        for first, stop in row:
            closed[first:stop, contact] = True
    return closed


@dataclass(frozen=True, kw_only=True)
class Move(ABC):
    """One change of the windows of one contact."""

    contact: int

    @abstractmethod
    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        """The windows of the contact after the move, or None where it does not apply."""

    @abstractmethod
    def undo(self, windows: Windows) -> Move:
        """The move that leads from the result back to `windows`."""

    def apply(self, windows: Windows, steps: int) -> Windows | None:
        """All windows after the move, or None: empty, overlapping or adjoining windows, or none of that index."""
        row = self.changed(windows[self.contact])
        if row is None or not _fits(row, steps):
            return None
        return (*windows[: self.contact], row, *windows[self.contact + 1 :])


@dataclass(frozen=True, kw_only=True)
class MoveEnd(Move):
    """One end of a window (0 its first step, 1 its stop) by some steps."""

    index: int
    end: int
    by: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        if not 0 <= self.index < len(row):
            return None
        first, stop = row[self.index]
        moved = (first + self.by, stop) if self.end == 0 else (first, stop + self.by)
        return (*row[: self.index], moved, *row[self.index + 1 :])

    def undo(self, windows: Windows) -> Move:
        return MoveEnd(contact=self.contact, index=self.index, end=self.end, by=-self.by)


@dataclass(frozen=True, kw_only=True)
class Translate(Move):
    """A whole window by some steps."""

    index: int
    by: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        if not 0 <= self.index < len(row):
            return None
        first, stop = row[self.index]
        return (*row[: self.index], (first + self.by, stop + self.by), *row[self.index + 1 :])

    def undo(self, windows: Windows) -> Move:
        return Translate(contact=self.contact, index=self.index, by=-self.by)


@dataclass(frozen=True, kw_only=True)
class SplitWindow(Move):
    """A window opens in first <= t < stop, strictly inside it."""

    index: int
    first: int
    stop: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        if not 0 <= self.index < len(row) or self.first >= self.stop:
            return None
        first, stop = row[self.index]
        if not first < self.first < self.stop < stop:
            return None
        return (*row[: self.index], (first, self.first), (self.stop, stop), *row[self.index + 1 :])

    def undo(self, windows: Windows) -> Move:
        return Merge(contact=self.contact, index=self.index)


@dataclass(frozen=True, kw_only=True)
class Merge(Move):
    """A window and the next become one: the contact stays closed between them."""

    index: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        if not 0 <= self.index < len(row) - 1:
            return None
        return (*row[: self.index], (row[self.index][0], row[self.index + 1][1]), *row[self.index + 2 :])

    def undo(self, windows: Windows) -> Move:
        row = windows[self.contact]
        return SplitWindow(contact=self.contact, index=self.index, first=row[self.index][1], stop=row[self.index + 1][0])


@dataclass(frozen=True, kw_only=True)
class Add(Move):
    """A new window where the contact is open."""

    first: int
    stop: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        return tuple(sorted((*row, (self.first, self.stop))))

    def undo(self, windows: Windows) -> Move:
        index = sum(window[0] < self.first for window in windows[self.contact])
        return Drop(contact=self.contact, index=index)


@dataclass(frozen=True, kw_only=True)
class Drop(Move):
    """A window less."""

    index: int

    def changed(self, row: tuple[Window, ...]) -> tuple[Window, ...] | None:
        return (*row[: self.index], *row[self.index + 1 :]) if 0 <= self.index < len(row) else None

    def undo(self, windows: Windows) -> Move:
        first, stop = windows[self.contact][self.index]
        return Add(contact=self.contact, first=first, stop=stop)


def onwards(before: Windows, after: Windows, times: int, steps: int) -> Windows | None:
    """`after` with every end moved on by so many times its way from `before`; None unless both have the same windows and room is left."""
    if [len(row) for row in before] != [len(row) for row in after]:
        return None
    moved = tuple(
        tuple((b[0] + times * (b[0] - a[0]), b[1] + times * (b[1] - a[1])) for a, b in zip(old, new, strict=True))
        for old, new in zip(before, after, strict=True)
    )
    return moved if all(_fits(row, steps) for row in moved) else None


def _fits(row: tuple[Window, ...], steps: int) -> bool:
    """Whether windows lie in the horizon, none empty, none overlapping or adjoining."""
    return all(0 <= first < stop <= steps for first, stop in row) and all(before[1] < after[0] for before, after in pairwise(row))


def shifts(windows: Windows, stride: int) -> Iterator[Move]:
    """Every end and every window, moved by one stride either way."""
    for contact, row in enumerate(windows):
        for index in range(len(row)):
            for by in (-stride, stride):
                yield MoveEnd(contact=contact, index=index, end=0, by=by)
                yield MoveEnd(contact=contact, index=index, end=1, by=by)
                yield Translate(contact=contact, index=index, by=by)


def fewer(windows: Windows) -> Iterator[Move]:
    """Each window dropped, the last of a contact first (those that remain keep their index), and each merged with the next."""
    for contact, row in enumerate(windows):
        for index in reversed(range(len(row))):
            yield Drop(contact=contact, index=index)
            yield Merge(contact=contact, index=index)


def rearrangements(windows: Windows, phi: np.ndarray) -> Iterator[Move]:
    """Windows merged, dropped, split where they press least, added where bodies come nearest; phi (steps, nc) of the present plan."""
    for contact, row in enumerate(windows):
        depth = phi[:, contact]
        for index, (first, stop) in enumerate(row):
            if index + 1 < len(row):
                yield Merge(contact=contact, index=index)
            yield Drop(contact=contact, index=index)
            if stop - first >= 3:
                least = first + 1 + int(depth[first + 1 : stop - 1].argmin())
                yield SplitWindow(contact=contact, index=index, first=least, stop=least + 1)
        edges = [0, *(edge for window in row for edge in window), len(depth)]
        for first, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - first >= 3:
                nearest = first + 1 + int(depth[first + 1 : stop - 1].argmax())
                yield Add(contact=contact, first=nearest, stop=nearest + 1)


def repetitions(windows: Windows, steps: int) -> Iterator[Move]:
    """Every window once more, as long as it is, before or after it where the contact is open; where a contact has none, one as long as the
    others' at places all over the horizon."""
    lengths = sorted(stop - first for row in windows for first, stop in row)
    usual = lengths[len(lengths) // 2] if lengths else max(1, steps // 20)
    for contact, row in enumerate(windows):
        wanted = [(first + sign * round(part * steps), stop - first) for first, stop in row for part in _APART for sign in (-1, 1)]
        if not row:
            wanted = [(round(place * steps), usual) for place in _PLACES]
        for begin, length in wanted:
            if begin >= 1 and begin + length <= steps and all(begin + length < before or begin > after for before, after in row):
                yield Add(contact=contact, first=begin, stop=begin + length)


# A neighbour counts as cheaper by this part of the cost: well above the rounding of a solve (1e-13), far below what a step of a window costs.
GAIN = 1e-10
_PULL = 1e-6  # a multiplier [cost per N] that is clearly not zero
_ALONE = 20  # pairs that are switched one by one where switching them together does not help
_DETOUR = 40  # plans tried on a detour; from two pushes to one, 27 steps away, 20 are enough
_STRETCH = 4  # of the longest stride: the first on a detour


class ModePlan(Protocol):
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


Answer = TypeVar("Answer", bound=ModePlan)
Improve = Callable[[np.ndarray, Answer, float], Answer | None]  # (modes, neighbour, below) -> its optimum if that costs less, else None


@dataclass(frozen=True, kw_only=True)
class SearchResult(Generic[Answer]):
    """best: the cheapest; tried: neighbours solved; complete: no neighbour is cheaper (False: stopped before that was known)."""

    best: Answer
    tried: int
    complete: bool


def search_windows(
    best: Answer, improve: Improve[Answer], *, stride: int, is_over: Callable[[], bool], far: bool = True
) -> SearchResult[Answer]:
    """From `best` downhill. stride: the first stride in steps; is_over: whether to stop; far: whether to look further than a move."""
    return _Search(best, improve, is_over).run(stride, far)


def follow_pulls(best: Answer, improve: Improve[Answer], *, is_over: Callable[[], bool]) -> SearchResult[Answer]:
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

    def found(self, *, complete: bool) -> SearchResult[Answer]:
        return SearchResult(best=self._best, tried=self._tried, complete=complete)

    def run(self, stride: int, far: bool) -> SearchResult[Answer]:
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
