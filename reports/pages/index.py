"""The last section of report.html: what each of the other pages shows, in a sentence with its main figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.findings import NOT_ASKED, last_cost
from reports.pages.section import Report, Section
from reports.records.record import HOLD, SceneRecord
from reports.wording import cost


@dataclass(frozen=True)
class SceneLink:
    """A scene; holds: so many of its `asked` runs, which could; best: the pipeline of its cheapest plan that holds, and that cost."""

    scene: SceneRecord
    link: str
    holds: int
    asked: int
    best: str


def build(report: Report, others: Sequence[tuple[str, Section]]) -> Section | None:
    """The section. others: (file name, first section) of each page that is neither a scene's nor a run's."""
    pages = [(report.page_link(name, section.anchor if report.single else ""), section.title, section.said) for name, section in others]
    if not report.scenes and not pages:
        return None
    return Section("index", "More pages", "index.html", {"scenes": [_scene(report, scene) for scene in report.scenes], "pages": pages})


def _scene(report: Report, scene: SceneRecord) -> SceneLink:
    mine = [run for run in report.stored.runs if run.scene.name == scene.name]
    asked = [run for run in mine if run.verdict not in NOT_ASKED]
    holding = [run for run in asked if run.verdict in HOLD]
    best = min((run for run in holding if last_cost(run) is not None), key=lambda run: last_cost(run) or 0.0, default=None)
    said = f"{best.pipeline}, cost {cost(last_cost(best))}" if best is not None else ""
    return SceneLink(scene, report.scene_link(scene), len(holding), len(asked), said)
