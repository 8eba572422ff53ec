"""Sections of pages, and the report they are built from."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

from models.results.run import RunRecord, SceneRecord, StageRecord
from reports.load import Stored
from reports.rows import Row, rows_of
from reports.traces import Motion, Trace, read_motion, read_plan

REPORT = "report.html"
PAGES = "pages"
# Length of a key's digest in the names of pages.
_SHORT = 8
# Characters removed from the names of files.
_KEPT = re.compile(r"[^\w.-]+", re.ASCII)
# Largest length of a scene or pipeline in a page's name.
_LONGEST = 80
# Names of scenes that are valid names of files.
_PLAIN = re.compile(r"[\w-]{1,80}", re.ASCII)


@dataclass(frozen=True)
class Report:
    """The stored records of a campaign, with their rows and scenes.

    folder: with motions; at: prefix of links to other pages; single: one file with anchors.
    """

    stored: Stored
    folder: Path = Path()
    at: str = f"{PAGES}/"
    single: bool = False

    @cached_property
    def rows(self) -> list[Row]:
        """Return every stage once, in the order of the paper's table."""
        return rows_of(self.stored.runs, self.link)

    @cached_property
    def scenes(self) -> list[SceneRecord]:
        """Return every scene once, in the order of the campaign."""
        by_name: dict[str, SceneRecord] = {}
        for run in self.stored.runs:
            by_name.setdefault(run.scene.name, run.scene)
        return list(by_name.values())

    def rows_of_scene(self, scene: SceneRecord) -> list[Row]:
        """Return the rows of one scene."""
        return [row for row in self.rows if row.run.scene.name == scene.name]

    def is_papers(self, scene: SceneRecord) -> bool:
        """Return whether the scene has the paper's numbers; an equal name is not enough."""
        return any(row.stage.paper for row in self.rows_of_scene(scene))

    def anchor(self, run: RunRecord) -> str:
        """Return the anchor of a run on a page of all runs."""
        return self._anchors[id(run)]

    @cached_property
    def _anchors(self) -> dict[int, str]:
        return {id(run): f"run-{place}" for place, run in enumerate(self.stored.runs, 1)}

    @cached_property
    def pages(self) -> dict[str, str]:
        """Return the names of runs' pages by key."""
        return run_pages(self.stored.runs)

    def link(self, run: RunRecord) -> str:
        """Return a link to the run's page, or to its row among all runs."""
        if self.single:
            return f"#{self.anchor(run)}"
        page = self.pages.get(run.key)
        return self.at + (quote(page) if page else f"runs.html#{self.anchor(run)}")

    def scene_anchor(self, scene: SceneRecord) -> str:
        """Return the anchor of a scene on a page of all scenes."""
        return f"scene-{self.scenes.index(scene) + 1}"

    def scene_link(self, scene: SceneRecord) -> str:
        """Return a link to a scene."""
        return f"#{self.scene_anchor(scene)}" if self.single else self.at + quote(scene_page(scene))

    def page_link(self, page: str, anchor: str = "") -> str:
        """Return a link to another page, or to an anchor on it."""
        return (
            f"#{anchor or page}"
            if self.single
            else f"{self.at}{page}.html" + (f"#{anchor}" if anchor else "")
        )

    def motion(self, run: RunRecord, stage: StageRecord) -> Motion:
        """Return plan and replays of a stage."""
        return read_motion(self.folder / "runs" / run.key, run, stage)

    def plan(self, run: RunRecord, stage: StageRecord) -> Trace | None:
        """Return the plan of a stage."""
        return read_plan(self.folder / "runs" / run.key, run, stage)


def run_pages(runs: Sequence[RunRecord]) -> dict[str, str]:
    """Return the names of runs' pages by key: `SCENE--PIPELINE.html`, with a digest if shared.

    Runs that do not apply to their scene have no page.
    """
    names = {
        run.key: f"{_plain(run.scene.name)}--{_plain(run.pipeline)}"
        for run in runs
        if run.verdict != "not applicable"
    }
    counts = Counter(name.lower() for name in names.values())
    return {
        key: f"{name}.html" if counts[name.lower()] == 1 else f"{name}-{_digest(key)[:_SHORT]}.html"
        for key, name in names.items()
    }


def _plain(name: str) -> str:
    return _KEPT.sub("-", name).strip("-.")[:_LONGEST] or "unnamed"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()


def scene_page(scene: SceneRecord) -> str:
    """Return the name of a scene's page, with a digest for an invalid file name."""
    name = scene.name if _PLAIN.fullmatch(scene.name) else _digest(scene.name)[:16]
    return f"scene-{name}.html"


@dataclass(frozen=True)
class Section:
    """A section: `template` (file.html, or file.html#block) with `values` and the section itself.

    entries: lines of the table of contents. `said`: main result for the index of report.html.
    """

    anchor: str
    title: str
    template: str
    values: dict[str, Any] = field(default_factory=dict)
    entries: tuple[tuple[str, str], ...] = ()
    said: str = ""
