"""What a section is made from, and what it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from reports.load import Stored
from reports.record import RunRecord, SceneRecord
from reports.rows import Row, rows_of, run_anchor, scenes_of


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
        return run_anchor(self.stored.runs, run)


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
