"""Contact windows and the moves between neighbours.

A window (first, stop) is a run of steps first <= t < stop in which a contact is closed; `Windows` holds those of each contact, in order.

    windows = windows_of(closed)                       # closed (steps, nc)
    MoveEnd(contact=0, index=0, end=0, by=-2).apply(windows, steps)     # a window begins two steps earlier

A move that is not possible gives None. `undo(windows)` of a move is the move that takes its result back to `windows`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

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
class Split(Move):
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
        return Split(contact=self.contact, index=self.index, first=row[self.index][1], stop=row[self.index + 1][0])


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
                yield Split(contact=contact, index=index, first=least, stop=least + 1)
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
