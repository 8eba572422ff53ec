"""What a section is made from, and what it is."""

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

from reports.records.load import Stored
from reports.records.record import RunRecord, SceneRecord, StageRecord
from reports.rows import Row, rows_of
from reports.traces import Motion, Trace, read_motion, read_plan

# The campaign's page, and the folder of all others beside it.
REPORT = "report.html"
PAGES = "pages"
# Length of the digest of a key that tells runs of one name apart.
_SHORT = 8
# Characters of a name that the name of a file keeps.
_KEPT = re.compile(r"[^\w.-]+", re.ASCII)
# Longest part of a page's name that stands for a scene or a pipeline.
_LONGEST = 80
# Names of scenes that are names of files as they are.
_PLAIN = re.compile(r"[\w-]{1,80}", re.ASCII)


@dataclass(frozen=True)
class Report:
    """The stored records of a campaign, and the rows and scenes in them.

    folder: the campaign's, where motions are read from; at: what links to other pages begin with;
        single: everything stands in one file, so that links
    lead to anchors in it.
    """

    stored: Stored
    folder: Path = Path()
    at: str = f"{PAGES}/"
    single: bool = False

    @cached_property
    def rows(self) -> list[Row]:
        """Every stage once, in the order of the paper's table."""
        return rows_of(self.stored.runs, self.link)

    @cached_property
    def scenes(self) -> list[SceneRecord]:
        """Every scene once, in the order of the campaign."""
        found: dict[str, SceneRecord] = {}
        for run in self.stored.runs:
            found.setdefault(run.scene.name, run.scene)
        return list(found.values())

    def rows_of_scene(self, scene: SceneRecord) -> list[Row]:
        """The rows of one scene."""
        return [row for row in self.rows if row.run.scene.name == scene.name]

    def is_papers(self, scene: SceneRecord) -> bool:
        """Whether the paper's numbers stand beside ours.

        A scene of its scene's name may be anybody's.
        """
        return any(row.stage.paper for row in self.rows_of_scene(scene))

    def anchor(self, run: RunRecord) -> str:
        """Where the run stands on a page that has all of them."""
        return self._anchors[id(run)]

    @cached_property
    def _anchors(self) -> dict[int, str]:
        return {id(run): f"run-{place}" for place, run in enumerate(self.stored.runs, 1)}

    @cached_property
    def pages(self) -> dict[str, str]:
        """The names of the pages of runs, by their keys."""
        return run_pages(self.stored.runs)

    def link(self, run: RunRecord) -> str:
        """Return the target of links to the run: its page, or its row among all runs if it has none."""
        if self.single:
            return f"#{self.anchor(run)}"
        page = self.pages.get(run.key)
        return self.at + (quote(page) if page else f"runs.html#{self.anchor(run)}")

    def scene_anchor(self, scene: SceneRecord) -> str:
        """Where the scene stands on a page that has all of them."""
        return f"scene-{self.scenes.index(scene) + 1}"

    def scene_link(self, scene: SceneRecord) -> str:
        """What a link to the scene leads to."""
        return f"#{self.scene_anchor(scene)}" if self.single else self.at + quote(scene_page(scene))

    def page_link(self, page: str, anchor: str = "") -> str:
        """What a link to one of the other pages leads to.

        Its first section has its name. anchor: of something else on it.
        """
        return (
            f"#{anchor or page}"
            if self.single
            else f"{self.at}{page}.html" + (f"#{anchor}" if anchor else "")
        )

    def motion(self, run: RunRecord, stage: StageRecord) -> Motion:
        """Plan and replays of a stage of the run."""
        return read_motion(self.folder / "runs" / run.key, run, stage)

    def plan(self, run: RunRecord, stage: StageRecord) -> Trace | None:
        """The plan of a stage of the run."""
        return read_plan(self.folder / "runs" / run.key, run, stage)


def run_pages(runs: Sequence[RunRecord]) -> dict[str, str]:
    """Return the names of the pages of runs, by their keys.

    A name is `SCENE--PIPELINE.html`, with part of a digest of the key if runs would share it. A run
    that does not apply to its scene has no page.
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
    """The name of the scene's page; of a name that is none of a file, a digest."""
    name = scene.name if _PLAIN.fullmatch(scene.name) else _digest(scene.name)[:16]
    return f"scene-{name}.html"


@dataclass(frozen=True)
class Section:
    """`template` in reports/templates (file.html, or file.html#block) gets `values` and the `section` itself; `entries` are lines of the table of contents below it.

    said: a sentence with its main figure, for the index of report.html.
    """

    anchor: str
    title: str
    template: str
    values: dict[str, Any] = field(default_factory=dict)
    entries: tuple[tuple[str, str], ...] = ()
    said: str = ""
