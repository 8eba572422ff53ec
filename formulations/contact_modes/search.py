"""Search mode sequences locally: take the first cheaper neighbour until none is cheaper.

    sequence = mode_sequence(closed)  # per contact intervals first <= t < stop
    shift(0, 0, first=-2).apply(sequence, steps)  # close two steps earlier, or None

Touching pairs whose multiplier has the wrong sign are switched first. Then intervals are dropped,
shifted by strides that are halved without success, repeated and rearranged. Detours accept a more
expensive sequence and shift it for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from formulations.contact_modes.quadratic import ModesAnswer

Interval = tuple[int, int]
Row = tuple[Interval, ...]
ModeSequence = tuple[Row, ...]

# Distances of an interval from its repetition, as shares of the horizon.
_APART = (0.05, 0.1, 0.15, 0.2, 0.3)
# Places of a contact's first interval, as shares of the horizon.
_PLACES = tuple(0.05 * place for place in range(1, 20))


def mode_sequence(closed: np.ndarray) -> ModeSequence:
    """Return the intervals in which each contact is closed, from closed (steps, nc) [-].

    Raises ValueError unless closed has two dimensions.
    """
    sequence = []
    for column in np.asarray(closed, dtype=bool).T:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]])))
        sequence.append(tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)))
    return tuple(sequence)


def closed_steps(sequence: ModeSequence, steps: int) -> np.ndarray:
    """Return closed (steps, nc) [-]: the inverse of `mode_sequence`. Raises nothing."""
    closed = np.zeros((steps, len(sequence)), dtype=bool)
    for contact, row in enumerate(sequence):
        for first, stop in row:
            closed[first:stop, contact] = True
    return closed


@dataclass(frozen=True)
class Move:
    """One change of a contact's intervals; `change` returns None if it does not apply."""

    contact: int
    change: Callable[[Row], Row | None]

    def apply(self, sequence: ModeSequence, steps: int) -> ModeSequence | None:
        """Return the sequence after the move, or None if it does not fit."""
        row = self.change(sequence[self.contact])
        if row is None or not _fits(row, steps):
            return None
        return (*sequence[: self.contact], row, *sequence[self.contact + 1 :])


def _replace(contact: int, index: int, replacement: Callable[..., Row], count: int = 1) -> Move:
    def change(row: Row) -> Row | None:
        return (
            (*row[:index], *replacement(*row[index : index + count]), *row[index + count :])
            if index + count <= len(row)
            else None
        )

    return Move(contact, change)


def shift(contact: int, index: int, first: int = 0, stop: int = 0) -> Move:
    """Move the start and the stop of an interval by these steps."""
    return _replace(contact, index, lambda old: ((old[0] + first, old[1] + stop),))


def split(contact: int, index: int, first: int, stop: int) -> Move:
    """Open an interval in first <= t < stop, strictly inside it."""
    return _replace(contact, index, lambda old: ((old[0], first), (stop, old[1])))


def merge(contact: int, index: int) -> Move:
    """Join an interval with the next one."""
    return _replace(contact, index, lambda old, following: ((old[0], following[1]),), 2)


def drop(contact: int, index: int) -> Move:
    """Remove an interval."""
    return _replace(contact, index, lambda old: ())


def add(contact: int, first: int, stop: int) -> Move:
    """Insert an interval."""
    return Move(contact, lambda row: tuple(sorted((*row, (first, stop)))))


def onwards(
    before: ModeSequence, after: ModeSequence, times: int, steps: int
) -> ModeSequence | None:
    """Repeat the change from `before` to `after` this many times; None if it does not fit."""
    if [len(row) for row in before] != [len(row) for row in after]:
        return None
    moved = tuple(
        tuple(
            (b[0] + times * (b[0] - a[0]), b[1] + times * (b[1] - a[1]))
            for a, b in zip(old, new, strict=True)
        )
        for old, new in zip(before, after, strict=True)
    )
    return moved if all(_fits(row, steps) for row in moved) else None


def _fits(row: Row, steps: int) -> bool:
    return all(0 <= first < stop <= steps for first, stop in row) and all(
        before[1] < after[0] for before, after in pairwise(row)
    )


def shifts(sequence: ModeSequence, stride: int) -> Iterator[Move]:
    """Yield shifts of the start, the stop or both of each interval by one stride, either way."""
    for contact, row in enumerate(sequence):
        for index in range(len(row)):
            for by in (-stride, stride):
                yield shift(contact, index, first=by)
                yield shift(contact, index, stop=by)
                yield shift(contact, index, first=by, stop=by)


def fewer(sequence: ModeSequence) -> Iterator[Move]:
    """Yield drops and merges, from the last interval on so that indices stay valid."""
    for contact, row in enumerate(sequence):
        for index in reversed(range(len(row))):
            yield drop(contact, index)
            yield merge(contact, index)


def rearrangements(sequence: ModeSequence, phi: np.ndarray) -> Iterator[Move]:
    """Yield merges, drops, splits at the least penetration, and additions at the smallest gap.

    phi (steps, nc) [m] is the penetration along the plan. Raises IndexError for fewer contacts.
    """
    for contact, row in enumerate(sequence):
        depth = phi[:, contact]
        for index, (first, stop) in enumerate(row):
            if index + 1 < len(row):
                yield merge(contact, index)
            yield drop(contact, index)
            if stop - first >= 3:
                least = first + 1 + int(depth[first + 1 : stop - 1].argmin())
                yield split(contact, index, first=least, stop=least + 1)
        edges = [0, *(edge for interval in row for edge in interval), len(depth)]
        for first, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - first >= 3:
                nearest = first + 1 + int(depth[first + 1 : stop - 1].argmax())
                yield add(contact, first=nearest, stop=nearest + 1)


def repetitions(sequence: ModeSequence, steps: int) -> Iterator[Move]:
    """Yield repetitions of each interval before or after it.

    A contact without intervals gets one of typical length at places all over the horizon.
    """
    lengths = sorted(stop - first for row in sequence for first, stop in row)
    usual = lengths[len(lengths) // 2] if lengths else max(1, steps // 20)
    for contact, row in enumerate(sequence):
        wanted = [
            (first + sign * round(part * steps), stop - first)
            for first, stop in row
            for part in _APART
            for sign in (-1, 1)
        ]
        if not row:
            wanted = [(round(place * steps), usual) for place in _PLACES]
        for begin, length in wanted:
            if (
                begin >= 1
                and begin + length <= steps
                and all(begin + length < before or begin > after for before, after in row)
            ):
                yield add(contact, first=begin, stop=begin + length)


# Smallest relative gain of a cheaper neighbour: above the rounding of a solve (1e-13), far below
# the effect of one step.
_GAIN = 1e-10
# A multiplier [cost per N] below minus this is negative.
_NEGATIVE = 1e-6
# Pairs switched one by one if switching them together fails.
_ALONE = 20
# Plans tried on a detour; from two pushes to one, 27 steps apart, takes 20.
_DETOUR = 40
# First stride of a detour, in longest strides.
_STRETCH = 4
# Largest relative extra cost of a detour by a repetition. Three carts moved by 0.6 m: two pushes on
# the left first cost 1.4 and 2.2 % more than one, finally 7.4 % less.
_DEARER = 0.05
# Number of the cheapest repetitions that are followed.
_REPEATED = 3
# Plans tried for each, before the best one continues.
_SHORT = 10


Answer = TypeVar("Answer", bound=ModesAnswer)
# (modes, neighbour, below) -> the optimum if it costs less than `below`, else None.
Improve = Callable[[np.ndarray, Answer, float], Answer | None]


@dataclass(frozen=True, kw_only=True)
class SearchResult(Generic[Answer]):
    """The cheapest plan, the number of solved neighbours, and whether all neighbours were tried."""

    best: Answer
    tried: int
    complete: bool


def search_sequences(
    best: Answer,
    improve: Improve[Answer],
    *,
    stride: int,
    is_over: Callable[[], bool],
    far: bool = True,
) -> SearchResult[Answer]:
    """Search downhill from `best`, with `stride` as the first stride in steps.

    far: whether to try repetitions and detours too
    """
    return _Search(best, improve, is_over).run(stride, far)


def flip_wrong_signs(
    best: Answer, improve: Improve[Answer], *, is_over: Callable[[], bool]
) -> SearchResult[Answer]:
    """Switch touching pairs whose multiplier has the wrong sign, as long as that helps."""
    search = _Search(best, improve, is_over)
    search.flip_wrong_signs()
    return search.found(complete=not is_over())


class _Search(Generic[Answer]):
    def __init__(
        self,
        best: Answer,
        improve: Improve[Answer],
        is_over: Callable[[], bool],
        most: float = np.inf,
    ) -> None:
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
            self.flip_wrong_signs()
            self._any(fewer(mode_sequence(self._best.closed)))
        while not self._is_over():
            self.flip_wrong_signs()
            helped = self._any(shifts(mode_sequence(self._best.closed), stride))
            if not helped and stride == 1:
                helped = self._any(rearrangements(mode_sequence(self._best.closed), self._best.phi))
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
        while stride and not self._is_over():
            self.flip_wrong_signs()
            stride = (
                stride
                if self._any(shifts(mode_sequence(self._best.closed), stride))
                else stride // 2
            )
        return self._best

    def _detours(self, stride: int) -> bool:
        """Return whether shifts of a shorter or repeated sequence lead to a cheaper plan."""
        begin, sequence = self._best, mode_sequence(self._best.closed)
        for move in fewer(sequence):
            start = self._moved(move, sequence, np.inf)
            if start is not None and self._taken(self._shifted(start, stride, _DETOUR), begin):
                return True
        most = (1.0 + _DEARER) * begin.cost if begin.cost > 0.0 else np.inf
        starts = [
            start
            for move in repetitions(sequence, self._steps)
            if (start := self._moved(move, sequence, most)) is not None
        ]
        ways = [
            self._shifted(start, stride, _SHORT)
            for start in sorted(starts, key=lambda start: start.cost)[:_REPEATED]
        ]
        if not ways:
            return False
        best = min(ways, key=lambda way: way.cost)
        return self._taken(best, begin) or self._taken(self._shifted(best, stride, _DETOUR), begin)

    def _moved(self, move: Move, sequence: ModeSequence, below: float) -> Answer | None:
        moved = move.apply(sequence, self._steps)
        if moved is None or self._is_over():
            return None
        self._tried += 1
        return self._improve(closed_steps(moved, self._steps), self._best, below)

    def _shifted(self, start: Answer, stride: int, most: int) -> Answer:
        way = _Search(start, self._improve, self._is_over, most)
        end = way.shift(_STRETCH * stride)
        self._tried += way.found(complete=True).tried
        return end

    def _taken(self, end: Answer, begin: Answer) -> bool:
        if not end.cost < begin.cost - _GAIN * abs(begin.cost):
            return False
        self._best = end
        return True

    def _any(self, moves: Iterable[Move]) -> bool:
        helped = False
        for move in moves:
            while self._step(move):
                helped = True
        return helped

    def _step(self, move: Move, sequence: ModeSequence | None = None) -> bool:
        return self._lead(move.apply(sequence or mode_sequence(self._best.closed), self._steps))

    def _lead(self, moved: ModeSequence | None) -> bool:
        return (
            moved is not None
            and not self._is_over()
            and self._take(closed_steps(moved, self._steps))
        )

    def _repeat(self) -> bool:
        begin, sequence = self._best, mode_sequence(self._best.closed)
        for move in repetitions(sequence, self._steps):
            self._step(move, sequence)
        return self._best is not begin

    def flip_wrong_signs(self) -> None:
        """Switch pairs with negative multipliers: all, the worst half, quarter .., or single ones.

        A change that helped is repeated with increasing length.
        """
        times = 1
        while not self._is_over():
            before, multiplier = mode_sequence(self._best.closed), self._best.biactive_multiplier
            order = np.argsort(multiplier, axis=None)[: int((multiplier < -_NEGATIVE).sum())]
            together = [
                order[: len(order) >> halvings] for halvings in range(len(order).bit_length())
            ]
            single = [order[one : one + 1] for one in range(1, min(len(order), _ALONE))]
            if not any(self._switch(pairs) for pairs in (*together, *single)):
                return
            helped = self._lead(
                onwards(before, mode_sequence(self._best.closed), times, self._steps)
            )
            times = 2 * times if helped else max(1, times // 2)

    def _switch(self, pairs: np.ndarray) -> bool:
        closed = self._best.closed.copy()
        closed.reshape(-1)[pairs] ^= True
        return not self._is_over() and self._take(closed)

    def _take(self, closed: np.ndarray) -> bool:
        closed[0] = self._best.closed[0]  # the start decides the first step
        if closed.tobytes() in self._seen:
            return False
        self._seen.add(closed.tobytes())
        self._tried += 1
        answer = self._improve(closed, self._best, self._best.cost - _GAIN * abs(self._best.cost))
        if answer is None:
            return False
        self._best = answer
        return True
