"""The scene itself: equations, what it does not need, quantities with units, known answers."""

from __future__ import annotations

from reports.mathml import safe_mathml
from reports.pages.section import Report, Section
from reports.pages.sizes import method_sizes


def build(report: Report) -> Section | None:
    if not report.scenes:
        return None
    scenes = [
        (
            f"scene-{place}",
            scene,
            [(equation.caption, safe_mathml(equation.mathml), equation.mathml) for equation in scene.equations],
            method_sizes(report, scene.name),
        )
        for place, scene in enumerate(report.scenes, 1)
    ]
    entries = tuple((anchor, scene.name) for anchor, scene, *_ in scenes) if len(scenes) > 1 else ()
    return Section("scene", "The scene and its equations", "scene.html", {"scenes": scenes}, entries)
