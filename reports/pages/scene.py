"""A scene itself: what it is, its best plan at a few times, equations, what it does not need, quantities with units, known answers."""

from __future__ import annotations

from reports.pages.mathml import safe_mathml
from reports.pages.overview import best_strip
from reports.pages.section import Report, Section
from reports.pages.sizes import method_sizes
from reports.paper import SCENE as PAPER_SCENE
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


def build(report: Report, scene: SceneRecord) -> Section:
    """What the scene is, in a few words and a film strip, and what leads to its runs."""
    values = {
        "scene": scene,
        "strip": best_strip(report, scene.name),
        "table1": report.report_link("table1") if scene.name == PAPER_SCENE else "",
    }
    return Section(report.scene_anchor(scene), f"The scene {scene.name}", "scene.html", values)


def model(report: Report, scene: SceneRecord) -> Section:
    """Its equations, quantities and known answers."""
    equations = [(equation.caption, safe_mathml(equation.mathml), equation.mathml) for equation in scene.equations]
    values = {"scene": scene, "equations": equations, "sizes": method_sizes(report, scene.name), "time_step": time_step(report, scene.name)}
    return Section(f"model-{report.scenes.index(scene) + 1}", f"Equations and quantities of {scene.name}", "scene_model.html", values)
