"""A scene: its best plan in motion, contact forces, equations, quantities and known answers."""

from __future__ import annotations

import math
from typing import NamedTuple
from xml.etree import ElementTree

from markupsafe import Markup, escape

from models.results.run import RunRecord, SceneRecord
from reports.pages.player import Film, film
from reports.pages.section import Report, Section
from reports.pages.stage_plots import StagePlots, stage_plots
from reports.traces import Motion
from reports.wording import clean, cost, listing, number


def time_step(report: Report, scene: str) -> str:
    """Return a sentence on the stability of the scene's time step, "" if unknown."""
    campaign = report.stored.campaign
    known = (
        next((item for item in campaign.time_steps if item.scene == scene), None)
        if campaign
        else None
    )
    if known is None:
        return ""
    if not known.is_stable:
        return f"Past its stability limit: {known.sentence}"
    closed = listing(list(known.contacts)) or "no contact"
    grows = (
        f", the motion itself grows at {number(known.growth, 3)}/s there" if known.growth else ""
    )
    limit = (
        "at any step"
        if math.isinf(known.largest_step)
        else f"below {number(known.largest_step, 3)} s"
    )
    largest = f"the largest spectral radius of its Jacobian is {number(known.radius, 6)}, with {closed} closed{grows}"
    return f"The time step of {number(known.step)} s is stable in contact: {largest}; it is stable {limit}."


class Shown(NamedTuple):
    """The motion shown for a scene, and its plan in words; film: None without shapes."""

    run: RunRecord
    link: str
    said: str
    film: Film | None
    plots: StagePlots


def build(report: Report, scene: SceneRecord) -> Section:
    """Return the section of a scene, with its best plan's motion, positions and contact forces."""
    values = {
        "scene": scene,
        "shown": _shown(report, scene),
        "model": f"model-{report.scenes.index(scene) + 1}",
    }
    return Section(
        report.scene_anchor(scene), f"The scene {scene.name}", "scene.html#scene", values
    )


def motion(report: Report, scene: SceneRecord) -> Section | None:
    """Return a section with the best plan's motion only, None without motion or shapes."""
    shown = _shown(report, scene)
    return (
        Section("motion", scene.title, "scene.html#motion", {"shown": shown})
        if shown is not None and shown.film is not None
        else None
    )


def _shown(report: Report, scene: SceneRecord) -> Shown | None:
    """Return the cheapest plan that holds, else the one nearest to its replay, None if none."""
    holding = report.stored.cheapest(scene.name)
    candidates = [
        (run, f"The cheapest plan that holds: {run.pipeline}, cost {cost(price)}")
        for run, price in holding
    ]
    others = [
        row
        for row in report.rows_of_scene(scene)
        if row.stage is row.run.stages[-1] and row.metric("replay_error") is not None
    ]
    for row in sorted(others, key=lambda row: row.metric("replay_error") or 0.0):
        phrase = (
            "No plan holds; nearest to its replay stays"
            if scene.inputs
            else "Its free motion and the replay of it:"
        )
        candidates.append((row.run, f"{phrase} {row.run.pipeline}"))
    for run, phrase in candidates:
        stage = run.stages[-1]
        motion = report.motion(run, stage)
        plots = stage_plots(scene, stage, motion, whole=False)
        if plots.motion:
            return Shown(
                run,
                report.link(run),
                phrase,
                film(run, [*[Motion()] * (len(run.stages) - 1), motion]),
                plots,
            )
    return None


def model(report: Report, scene: SceneRecord) -> Section:
    """Return the section of equations, quantities and known answers."""
    equations = [
        (equation.caption, safe_mathml(equation.mathml), equation.mathml)
        for equation in scene.equations
    ]
    stages = (
        stage for run in report.stored.runs if run.scene.name == scene.name for stage in run.stages
    )
    # A size that differs between runs has its own row.
    sizes = list(
        dict.fromkeys(
            (stage.method, stage.size, stage.paper_size)
            for stage in stages
            if stage.size is not None and stage.paper_size is not None
        )
    )
    values = {
        "scene": scene,
        "equations": equations,
        "sizes": sizes,
        "time_step": time_step(report, scene.name),
    }
    return Section(
        f"model-{report.scenes.index(scene) + 1}",
        f"Equations and quantities of {scene.name}",
        "scene.html#model",
        values,
    )


_NAMESPACE = "{http://www.w3.org/1998/Math/MathML}"
# fmt: off
_ELEMENTS = frozenset(
    {
        "math", "mrow", "mi", "mn", "mo", "mtext", "mspace", "ms", "mfrac", "msqrt", "mroot", "mstyle", "merror", "mpadded",
        "mphantom", "mfenced", "menclose", "msub", "msup", "msubsup", "munder", "mover", "munderover", "mmultiscripts", "mtable",
        "mtr", "mtd", "mlabeledtr",
    }
)
_ATTRIBUTES = frozenset(
    {
        "display", "mathvariant", "stretchy", "fence", "separator", "lspace", "rspace", "linethickness", "accent", "accentunder",
        "form", "open", "close", "separators", "columnalign", "rowalign", "columnspacing", "rowspacing", "width", "height", "depth",
        "largeop", "movablelimits", "displaystyle", "scriptlevel", "notation",
    }
)
# fmt: on
# Depth beyond any equation, within the stack.
_DEEPEST = 60
# Length beyond any equation.
_LONGEST = 200_000
# True minus signs, and a d that more fonts have.
_SIGNS = {"-": "−", "ⅆ": "d", "&dd;": "d"}


def safe_mathml(text: str) -> Markup | None:
    """Return the equation as markup, None if it is no safe MathML (show text then)."""
    if len(text) > _LONGEST or "<!" in text or "<?" in text:
        return None
    try:
        root = ElementTree.fromstring(clean(text))
    except (ElementTree.ParseError, ValueError, RecursionError):
        return None
    inside = _markup(root, 0) if root.tag in ("math", f"{_NAMESPACE}math") else None
    return None if inside is None else Markup(inside)


def _markup(element: ElementTree.Element, depth: int) -> str | None:
    name = element.tag.removeprefix(_NAMESPACE) if isinstance(element.tag, str) else ""
    if name not in _ELEMENTS or depth > _DEEPEST:
        return None
    attributes = "".join(
        f' {key}="{escape(value)}"' for key, value in element.attrib.items() if key in _ATTRIBUTES
    )
    parts = [
        f"<{name}{attributes}>",
        str(escape(_SIGNS.get(element.text or "", element.text or ""))),
    ]
    for child in element:
        inside = _markup(child, depth + 1)
        if inside is None:
            return None
        parts += [inside, str(escape(child.tail or ""))]
    return "".join([*parts, f"</{name}>"])
