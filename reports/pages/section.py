"""What a section is made from, and what it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

from reports.parcels import Parcels, Token
from reports.records.load import Stored
from reports.records.record import RunRecord, SceneRecord, StageRecord
from reports.rows import Row, rows_of, run_anchors, scenes_of
from reports.shelf import Shelf


class Placeable(Protocol):
    """The section of a run (reports.article)."""

    def placed(self, parcels: Parcels, anchor: str, rows: Sequence[int | None], *, opened: bool) -> Token: ...


class Source(Protocol):
    """Where outlines come from (reports.outlines)."""

    shelf: Shelf

    def article(self, parts: Sequence[RunRecord]) -> Placeable: ...
    def whole(self, parts: Sequence[RunRecord]) -> RunRecord: ...
    def digest(self, outline: RunRecord) -> str: ...


@dataclass(frozen=True)
class Report:
    """The stored records, and the rows and scenes in them; source: where they come from, if they are outlines; parcels: what the page may fold."""

    stored: Stored
    source: Source | None = None
    parcels: Parcels = field(default_factory=Parcels)

    def article(self, run: RunRecord, *, opened: bool) -> Token:
        """The section of a run. Raises ValueError where the records have no source."""
        if self.source is None:
            raise ValueError("only records that come from a folder have sections")
        rows = [self.row_number(stage) for stage in run.stages]
        return self.source.article(self._parts[id(run)]).placed(self.parcels, self.anchor(run), rows, opened=opened)

    def whole(self, run: RunRecord) -> RunRecord:
        """The run with its traces."""
        return run if self.source is None else self.source.whole(self._parts[id(run)])

    def kept(self, make: Callable[[], str], runs: Iterable[RunRecord], *words: str) -> str:
        """What `make` makes of whole runs, and of these words: kept as long as all of them are the same."""
        if self.source is None:
            return make()
        digests = [self.source.digest(part) for run in runs for part in self._parts[id(run)]]
        return self.source.shelf.kept(make, *words, *digests)

    @cached_property
    def _parts(self) -> dict[int, tuple[RunRecord, ...]]:
        return dict(zip(map(id, self.stored.runs), self.stored.parts, strict=True))

    @cached_property
    def rows(self) -> list[Row]:
        return rows_of(self.stored.runs)

    @cached_property
    def scenes(self) -> list[SceneRecord]:
        return scenes_of(self.stored.runs)

    def rows_of_scene(self, scene: SceneRecord) -> list[Row]:
        return [row for row in self.rows if row.run.scene.name == scene.name]

    def anchor(self, run: RunRecord) -> str:
        return self._anchors[id(run)]

    @cached_property
    def _anchors(self) -> dict[int, str]:
        return run_anchors(self.stored.runs)

    def row_number(self, stage: StageRecord) -> int | None:
        """The number of a stage's row; None where its row is told of another run."""
        return self._numbers.get(id(stage))

    @cached_property
    def _numbers(self) -> dict[int, int]:
        return {id(row.stage): row.number for row in self.rows}


@dataclass(frozen=True)
class Section:
    """`template` in reports/templates gets `values` and the `section` itself; `entries` are lines of the table of contents below it;
    folds: a large page may fold it as a whole."""

    anchor: str
    title: str
    template: str
    values: dict[str, Any] = field(default_factory=dict)
    entries: tuple[tuple[str, str], ...] = ()
    folds: bool = True
