"""All scenes: what each is, how many of its runs hold, and what leads to its page."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.section import Report, Section
from reports.records.record import HOLD, SceneRecord


@dataclass(frozen=True)
class SceneLink:
    """A scene; holds: so many of its `asked` runs, which could."""

    scene: SceneRecord
    link: str
    holds: int
    asked: int


def build(report: Report) -> Section | None:
    """The section, or None where no run is stored."""
    if not report.scenes:
        return None
    listed = []
    for scene in report.scenes:
        verdicts = [run.verdict for run in report.stored.runs if run.scene.name == scene.name]
        asked = [verdict for verdict in verdicts if verdict not in ("not applicable", "consistent")]
        listed.append(SceneLink(scene, report.scene_link(scene), sum(verdict in HOLD for verdict in asked), len(asked)))
    return Section("scenes", "The scenes", "scenes.html", {"listed": listed})
