"""What a section is made from, and what it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from reports.load import Stored
from reports.record import RunRecord, SceneRecord, StageRecord
from reports.rows import Row, rows_of, run_anchors, scenes_of


@dataclass(frozen=True)
class Report:
    """The stored records, and the rows and scenes in them."""

    stored: Stored

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
