"""A scene itself: what it is, its best plan at a few times, equations, what it does not need, quantities with units, known answers."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.mathml import safe_mathml
from reports.pages.overview import best_strip
from reports.pages.section import Report, Section
from reports.paper import SCENE as PAPER_SCENE
from reports.records.record import SceneRecord, SizeRecord
from reports.wording import listing, number


@dataclass(frozen=True)
class MethodSize:
    """The model of one method; agrees: both counts are those on paper."""

    method: str
    title: str
    size: SizeRecord

    @property
    def agrees(self) -> bool:
        """Whether the solver was given as many unknowns and equations as were counted on paper."""
        size = self.size
        return (size.unknowns, size.equations) == (size.paper_unknowns, size.paper_equations)


def method_sizes(report: Report, scene: str) -> tuple[MethodSize, ...]:
    """One row a method that solved a model of the scene, in the order of the runs; a size that differs between runs has a row of its own."""
    found: dict[tuple[str, SizeRecord], MethodSize] = {}
    for run in report.stored.runs:
        for stage in run.stages if run.scene.name == scene else ():
            if stage.size is not None:
                found.setdefault((stage.method, stage.size), MethodSize(stage.method, stage.method_title, stage.size))
    return tuple(found.values())


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
    return Section(report.scene_anchor(scene), f"The scene {scene.name}", "scene.html#scene", values)


def model(report: Report, scene: SceneRecord) -> Section:
    """Its equations, quantities and known answers."""
    equations = [(equation.caption, safe_mathml(equation.mathml), equation.mathml) for equation in scene.equations]
    values = {"scene": scene, "equations": equations, "sizes": method_sizes(report, scene.name), "time_step": time_step(report, scene.name)}
    return Section(f"model-{report.scenes.index(scene) + 1}", f"Equations and quantities of {scene.name}", "scene.html#model", values)
