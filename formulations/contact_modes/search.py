"""A local search over contact mode sequences: the first neighbour that is cheaper is taken, until there is none.

A mode sequence says for each contact in which intervals of steps it is closed. An interval (first,
stop) is a run of steps first <= t < stop.

    sequence = mode_sequence(closed)                                      # closed (steps, nc)
    # the contact closes two steps earlier; None where that is not possible
    shift(0, 0, first=-2).apply(sequence, steps)

Where a pair touches and its multiplier has the wrong sign, the other mode is cheaper to first
order: such pairs are switched before anything is tried. Then intervals that are not needed are
dropped, and long strides begin, halved whenever no shift helps. Between the longest stride and the
others intervals are repeated (a second push costs less than one twice as strong): none of the small
moves gets there. With a stride of one step intervals are also merged, dropped, split and added. A
move that helped is tried again at once. At last detours: an interval is dropped, two are merged, or
one is repeated, although that is dearer, and what is left is shifted for a while; two pushes become
one that way, at another time, or one becomes two where that pays only once the other contact has
moved. The search knows its problem by one question: is there a plan with these modes below this
cost?
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

_APART = (0.05, 0.1, 0.15, 0.2, 0.3)  # of the horizon: how far an interval is from its repetition
_PLACES = tuple(
    0.05 * place for place in range(1, 20)
)  # of the horizon: where a first interval of a contact is tried


def mode_sequence(closed: np.ndarray) -> ModeSequence:
    """Give the intervals in which each contact is closed.

    Parameters
    ----------
    closed : (steps, nc) [-], whether a contact is closed in a step

    Raises
    ------
    ValueError
        Unless closed has two dimensions.
    """
    found = []
    for column in np.asarray(closed, dtype=bool).T:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]])))
        found.append(tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)))
    return tuple(found)


def closed_steps(sequence: ModeSequence, steps: int) -> np.ndarray:
    """Give the steps in which each contact is closed: the inverse of `mode_sequence`.

    Returns
    -------
    (steps, nc) [-], whether a contact is closed in a step

    Raises nothing: what lies beyond the steps is left out.
    """
    closed = np.zeros((steps, len(sequence)), dtype=bool)
    for contact, row in enumerate(sequence):
        for first, stop in row:
            closed[first:stop, contact] = True
    return closed


@dataclass(frozen=True)
class Move:
    """One change of the intervals of one contact. change: from them to those after it, or None where there is no interval of that index."""

    contact: int
    change: Callable[[Row], Row | None]

    def apply(self, sequence: ModeSequence, steps: int) -> ModeSequence | None:
        """Give the sequence after the move, or None where intervals would be empty, overlap or adjoin, or there is none of that index."""
        row = self.change(sequence[self.contact])
        if row is None or not _fits(row, steps):
            return None
        return (*sequence[: self.contact], row, *sequence[self.contact + 1 :])


def _replace(contact: int, index: int, others: Callable[..., Row], count: int = 1) -> Move:
    """Others for `count` intervals from this index on."""

    def change(row: Row) -> Row | None:
        return (
            (*row[:index], *others(*row[index : index + count]), *row[index + count :])
            if index + count <= len(row)
            else None
        )

    return Move(contact, change)


def shift(contact: int, index: int, first: int = 0, stop: int = 0) -> Move:
    """An interval begins and stops so many steps later."""
    return _replace(contact, index, lambda old: ((old[0] + first, old[1] + stop),))


def split(contact: int, index: int, first: int, stop: int) -> Move:
    """An interval is interrupted in first <= t < stop, strictly inside it."""
    return _replace(contact, index, lambda old: ((old[0], first), (stop, old[1])))


def merge(contact: int, index: int) -> Move:
    """An interval and the next become one: the contact stays closed between them."""
    return _replace(contact, index, lambda old, following: ((old[0], following[1]),), 2)


def drop(contact: int, index: int) -> Move:
    """An interval less."""
    return _replace(contact, index, lambda old: ())


def add(contact: int, first: int, stop: int) -> Move:
    """A new interval where the contact is open."""
    return Move(contact, lambda row: tuple(sorted((*row, (first, stop)))))


def onwards(
    before: ModeSequence, after: ModeSequence, times: int, steps: int
) -> ModeSequence | None:
    """Move every end on from `after` by so many times its way from `before`.

    None unless both have as many intervals and room is left.
    """
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
    """Whether intervals lie in the horizon, none empty, none overlapping or adjoining."""
    return all(0 <= first < stop <= steps for first, stop in row) and all(
        before[1] < after[0] for before, after in pairwise(row)
    )


def shifts(sequence: ModeSequence, stride: int) -> Iterator[Move]:
    """Yield each interval with either end, or both, moved by one stride either way."""
    for contact, row in enumerate(sequence):
        for index in range(len(row)):
            for by in (-stride, stride):
                yield shift(contact, index, first=by)
                yield shift(contact, index, stop=by)
                yield shift(contact, index, first=by, stop=by)


def fewer(sequence: ModeSequence) -> Iterator[Move]:
    """Yield each interval dropped, the last of a contact first (those that remain keep their index), and each merged with the next."""
    for contact, row in enumerate(sequence):
        for index in reversed(range(len(row))):
            yield drop(contact, index)
            yield merge(contact, index)


def rearrangements(sequence: ModeSequence, phi: np.ndarray) -> Iterator[Move]:
    """Yield intervals merged, dropped, split where they press least, and added where bodies come nearest.

    Parameters
    ----------
    phi : (steps, nc) [m], penetration along the present plan

    Raises
    ------
    IndexError
        For a penetration of fewer contacts.
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
    """Yield each interval once more, as long as it is, before or after it where the contact is open.

    Where a contact has none, one as long as the others' is tried at places all over the horizon.
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


# A neighbour counts as cheaper by this part of the cost: well above the rounding of a solve
# (1e-13), far below what a step of an interval costs.
_GAIN = 1e-10
_NEGATIVE = 1e-6  # a multiplier [cost per N] that is clearly not zero
_ALONE = 20  # pairs that are switched one by one where switching them together does not help
_DETOUR = 40  # plans tried on a detour; from two pushes to one, 27 steps away, 20 are enough
_STRETCH = 4  # of the longest stride: the first on a detour
# Detours by a repetition: those that cost up to this part more, of these so many of the cheapest,
# each for so many plans before the best of them goes on. Three carts moved by 0.6 m: two pushes on
# the left cost 1.4 and 2.2 % more than one, and less after one and two plans; 7.4 % less in the
# end.
_DEARER = 0.05
_REPEATED = 3
_SHORT = 10


Answer = TypeVar("Answer", bound=ModesAnswer)
Improve = Callable[
    [np.ndarray, Answer, float], Answer | None
]  # (modes, neighbour, below) -> its optimum if that costs less, else None


@dataclass(frozen=True, kw_only=True)
class SearchResult(Generic[Answer]):
    """The cheapest plan, how many neighbours were solved, and whether none of them is cheaper (False: stopped before that was known)."""

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
    """Search downhill from `best`. stride: the first stride in steps; is_over: whether to stop.

    far: whether to look further than a move.
    """
    return _Search(best, improve, is_over).run(stride, far)


def flip_wrong_signs(
    best: Answer, improve: Improve[Answer], *, is_over: Callable[[], bool]
) -> SearchResult[Answer]:
    """Only switch touching pairs whose multiplier has the wrong sign, until none helps."""
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
        """Only shifts, down to those by one step."""
        while stride and not self._is_over():
            self.flip_wrong_signs()
            stride = (
                stride
                if self._any(shifts(mode_sequence(self._best.closed), stride))
                else stride // 2
            )
        return self._best

    def _detours(self, stride: int) -> bool:
        """Whether a plan of fewer intervals, or of one repeated, dearer as it may be, leads to a cheaper one by shifts."""
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
        """The plan of a sequence after a move, if it costs less than this."""
        moved = move.apply(sequence, self._steps)
        if moved is None or self._is_over():
            return None
        self._tried += 1
        return self._improve(closed_steps(moved, self._steps), self._best, below)

    def _shifted(self, start: Answer, stride: int, most: int) -> Answer:
        """Where shifts lead from a plan while no more than so many others are tried."""
        way = _Search(start, self._improve, self._is_over, most)
        end = way.shift(_STRETCH * stride)
        self._tried += way.found(complete=True).tried
        return end

    def _taken(self, end: Answer, begin: Answer) -> bool:
        """Whether it is cheaper, and the best from now on."""
        if not end.cost < begin.cost - _GAIN * abs(begin.cost):
            return False
        self._best = end
        return True

    def _any(self, moves: Iterable[Move]) -> bool:
        """Whether one of the moves helped; each is tried for as long as it does."""
        helped = False
        for move in moves:
            while self._step(move):
                helped = True
        return helped

    def _step(self, move: Move, sequence: ModeSequence | None = None) -> bool:
        """Whether a move of the best sequence, or of this one, is cheaper, and the best from now on."""
        return self._lead(move.apply(sequence or mode_sequence(self._best.closed), self._steps))

    def _lead(self, moved: ModeSequence | None) -> bool:
        return (
            moved is not None
            and not self._is_over()
            and self._take(closed_steps(moved, self._steps))
        )

    def _repeat(self) -> bool:
        """The cheapest of the plans with one interval repeated, if it is cheaper."""
        begin, sequence = self._best, mode_sequence(self._best.closed)
        for move in repetitions(sequence, self._steps):
            self._step(move, sequence)
        return self._best is not begin

    def flip_wrong_signs(self) -> None:
        """Switch the touching pairs whose multiplier is negative: all of them, else the worst half, quarter .. of them, else one by one.

        What helped once is tried again, ever further: every end of an interval as many steps on as
        it just went.
        """
        times = 1
        while not self._is_over():
            before, multiplier = mode_sequence(self._best.closed), self._best.biactive_multiplier
            order = np.argsort(multiplier, axis=None)[: int((multiplier < -_NEGATIVE).sum())]
            together = [
                order[: len(order) >> halvings] for halvings in range(len(order).bit_length())
            ]
            alone = [order[one : one + 1] for one in range(1, min(len(order), _ALONE))]
            if not any(self._switch(pairs) for pairs in (*together, *alone)):
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
        closed[0] = self._best.closed[0]  # the start decides the modes of the first step
        if closed.tobytes() in self._seen:
            return False
        self._seen.add(closed.tobytes())
        self._tried += 1
        found = self._improve(closed, self._best, self._best.cost - _GAIN * abs(self._best.cost))
        if found is None:
            return False
        self._best = found
        return True
