"""The scene itself: equations, what it does not need, quantities with units, known answers."""

from __future__ import annotations

import json

from markupsafe import Markup

from reports.mathml import safe_mathml
from reports.pages.section import Report, Section
from reports.pages.sizes import method_sizes
from reports.records.record import SceneRecord
from reports.wording import listing, number


def time_step(report: Report, scene: str) -> str:
    """What was known of the scene's time step before anything ran, in a sentence; empty where the campaign does not say."""
    campaign = report.stored.campaign
    known = next((item for item in campaign.time_steps if item.scene == scene), None) if campaign else None
    if known is None:
        return ""
    if known.warning:
        return f"Past its stability limit: {known.warning}"
    closed = listing(list(known.contacts)) or "no contact"
    grows = f", the motion itself grows at {number(known.growth, 3)}/s there" if known.growth else ""
    limit = "at any step" if known.largest_step is None else f"below {number(known.largest_step, 3)} s"
    return (
        f"The time step of {number(known.step)} s is stable in contact: the largest spectral radius of its Jacobian is {number(known.radius, 6)}, with {closed} "
        f"closed{grows}; it is stable {limit}."
    )


def _equations(report: Report, scene: SceneRecord) -> list[tuple[str, Markup | None, str]]:
    """Caption, markup (None where it cannot be trusted) and text of each equation."""
    texts = [equation.mathml for equation in scene.equations]
    told = json.loads(report.kept(lambda: json.dumps(list(map(safe_mathml, texts))), (), "equations", *texts))
    return [
        (equation.caption, None if markup is None else Markup(markup), equation.mathml)
        for equation, markup in zip(scene.equations, told, strict=True)
    ]


def build(report: Report) -> Section | None:
    if not report.scenes:
        return None
    scenes = [
        (
            f"scene-{place}",
            scene,
            _equations(report, scene),
            method_sizes(report, scene.name),
            time_step(report, scene.name),
        )
        for place, scene in enumerate(report.scenes, 1)
    ]
    entries = tuple((anchor, scene.name) for anchor, scene, *_ in scenes) if len(scenes) > 1 else ()
    return Section("scene", "The scene and its equations", "scene.html", {"scenes": scenes}, entries)
