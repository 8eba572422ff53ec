"""Make pages of the site at build time: the README, scenes, methods, metrics, public names.

pip install -e '.[docs]' && mkdocs build --strict

The gallery shows plans in motion from a campaign that was run here: runs/all, or the folder that
TOUCHSTONE_CAMPAIGN names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import formulations
import formulations.ampl
import formulations.mpec
import models.fmu
import models.scene
import touchstone
from formulations.pipelines import PIPELINES, load_method, method_names
from models.catalog import load_scene, scene_names
from models.kinematics import evaluate
from models.results.run import ShapeRecord
from models.scene import Scene
from reports.pages.player import placed
from reports.pages.scene import safe_mathml
from reports.render import render_players
from validate.judge.score.table import FEEDBACK, TABLE
from validate.judge.score.verdict import Question
from validate.tasks.scene_record import scene_record

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)#\s]+)(#[^)]*)?\)")
_FILE = re.compile(r"<!-- (?:file|into): ([\w./]+) -->\n```(\w+)\n")
_WIDTH = 300.0
_HEIGHT = 170.0
# Modules whose public names are the reference of `models`, and the objects of other pages, by their
# home.
_MODELS = {
    "models.catalog": ("load_scene", "scene_names"),
    "models.scene": tuple(models.scene.__all__),
    "models.dynamics": ("derive", "Dynamics"),
    "models.schemes": ("Scheme",),
    "models.contact_law": ("ContactLaw", "contact_force", "sharpness"),
    "models.trajectory": ("Trajectory", "Hold", "read_csv", "write_csv"),
    "models.codegen.kernel": ("load_kernel", "Kernel"),
    "models.fmu": tuple(models.fmu.__all__),
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    scenes = [load_scene(name) for name in scene_names()]
    pages = {
        "index.md": _from_root((ROOT / "README.md").read_text(encoding="utf-8")),
        "changelog.md": _from_root((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")),
        "scenes.md": _gallery(scenes),
        **{f"scenes/{scene.name}.md": _scene(scene) for scene in scenes},
        "methods.md": _methods(),
        "metrics.md": _metrics(),
        "reference/touchstone.md": _touchstone(),
        "reference/models.md": _reference(
            "models", [f"{home}.{name}" for home, names in _MODELS.items() for name in names]
        ),
        "reference/formulations.md": _reference(
            "formulations", [_home(formulations, name) for name in formulations.__all__]
        ),
        "reference/formulations.mpec.md": _reference(
            "formulations.mpec",
            [_home(formulations.mpec, name) for name in formulations.mpec.__all__],
        ),
        "reference/formulations.ampl.md": _reference(
            "formulations.ampl",
            [_home(formulations.ampl, name) for name in formulations.ampl.__all__],
        ),
    }
    pages |= _players(scenes, ROOT / config.extra["campaign"])
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links out of docs to pages of the site; keep only the words if there is no page.

    A file that the text writes bears its name.
    """

    def link(found: re.Match[str]) -> str:
        words, target, anchor = found[1], found[2], found[3] or ""
        if not target.startswith("../") or page.file.src_uri.count("/"):
            return found[0]
        inside = _in_site(target.removeprefix("../"))
        return f"{words}({inside}{anchor})" if inside else words.strip("![]")

    return _FILE.sub(r'```\2 title="\1"' + "\n", _LINK.sub(link, markdown))


def _in_site(path: str) -> str | None:
    """Return the page of a file of the repository, or None."""
    if path in ("README.md", "CHANGELOG.md"):
        return {"README.md": "index.md", "CHANGELOG.md": "changelog.md"}[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    scene = re.fullmatch(r"models/scenes/(\w+)\.py", path)
    return f"scenes/{scene[1]}.md" if scene else None


def _from_root(text: str) -> str:
    """Return a text of the repository's root as a page of docs."""
    return _LINK.sub(
        lambda found: (
            found[0] if "://" in found[2] else f"{found[1]}(../{found[2]}{found[3] or ''})"
        ),
        text,
    )


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a Markdown table, or nothing without rows."""
    lines = [
        "| " + " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in row) + " |"
        for row in rows
    ]
    columns = list(head)
    return (
        "\n".join(["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns), *lines]) + "\n\n"
        if lines
        else ""
    )


def _number(value: object) -> str:
    return (
        ""
        if value is None or value == ""
        else f"{float(value):.7g}"
        if isinstance(value, (int, float))
        else str(value)
    )


def _range(lower: float, upper: float) -> str:
    return f"{lower:g} .. {upper:g}" if math.isfinite(lower) or math.isfinite(upper) else "none"


def _gallery(scenes: list[Scene]) -> str:
    cards = "\n".join(
        f'<div markdown="span">{_picture(scene)}[{scene.name}](scenes/{scene.name}.md)<br>{scene.title}</div>'
        for scene in scenes
    )
    lead = (
        "Each scene is drawn at its start. A scene of your own is [one file](extending.md#a-scene)."
    )
    return f'# Scenes\n\n{lead}\n\n<div class="gallery" markdown="1">\n{cards}\n</div>\n'


def _players(scenes: list[Scene], campaign: Path) -> dict[str, str]:
    """Return the gallery of plans in motion, and a page for each scene of the campaign."""
    text = "# Plans in motion\n\n"
    if not (campaign / "campaign.json").is_file():
        return {
            "players.md": text
            + "This site was built without a campaign. Run `python -m validate all`, then build the site again.\n"
        }
    text += "The cheapest plan that holds on each scene, as planned (dashed) and as replayed through the FMU of the scene.\n"
    made = render_players(campaign)
    names = [scene.name for scene in scenes if scene.name in made]
    for name in names:
        text += f'\n## [{name}](scenes/{name}.md)\n\n<iframe class="player" src="players/{name}.html" title="{name} in motion" loading="lazy"></iframe>\n'
    return {"players.md": text, **{f"players/{name}.html": made[name] for name in names}}


def _picture(scene: Scene) -> str:
    """Return the shapes of a scene at its start as an SVG, or nothing."""
    if not scene.shapes:
        return ""
    values = scene.parameter_values
    records = [
        ShapeRecord(
            name=item.name,
            kind=item.kind,
            size=tuple(float(sp.sympify(size).subs(values)) for size in item.size),
        )
        for item in scene.shapes
    ]
    parts = [part for shape in scene.shapes for part in (shape.x, shape.y, shape.angle)]
    poses = evaluate(scene, parts, np.array([scene.task.start[: scene.nq]])).reshape(-1, 3)
    reach = [max(item.size) * {"disc": 1.0, "wall": 0.0}.get(item.kind, 0.5) for item in records]
    low = np.min([pose[:2] - far for pose, far in zip(poses, reach, strict=True)], axis=0)
    high = np.max([pose[:2] + far for pose, far in zip(poses, reach, strict=True)], axis=0)
    scale = 0.85 * min(_WIDTH / max(high[0] - low[0], 1e-9), _HEIGHT / max(high[1] - low[1], 1e-9))
    drawn = "".join(
        placed(item, pose, (low + high) / 2, scale, place % 6)
        for place, (item, pose) in enumerate(zip(records, poses, strict=True))
    )
    box = f"{-_WIDTH / 2:g} {-_HEIGHT / 2:g} {_WIDTH:g} {_HEIGHT:g}"
    frame = f'<rect class="frame" x="{-_WIDTH / 2:g}" y="{-_HEIGHT / 2:g}" width="{_WIDTH:g}" height="{_HEIGHT:g}"/>'
    return f'<svg class="scene-picture" viewBox="{box}" role="img" aria-label="{scene.name} at its start">{frame}{drawn}</svg>'


def _scene(scene: Scene) -> str:
    """Return the contents of a scene's file as tables."""
    task, record = scene.task, scene_record(scene)
    goal = ["free" if value is None else _number(value) for value in task.goal]
    text = [f"# {scene.name}\n\n{scene.title}. Source: {scene.source}.\n\n{_picture(scene)}\n"]
    if scene.unstable:
        text.append(
            f"Unstable in the open loop, so that a plan which holds with feedback is enough: {scene.unstable}.\n"
        )
    text.append(
        f"From t = 0 in {task.steps} steps of {task.step:g} s. Cost: the sum over the steps of `{task.running_cost}`"
        + (f", and `{task.final_cost}` at the end.\n" if task.final_cost != 0 else ".\n")
    )
    coordinates = [
        (
            f"`{item.name}`",
            item.unit,
            _number(task.start[place]),
            goal[place],
            _number(item.nominal),
            item.description,
        )
        for place, item in enumerate(scene.coordinates)
    ]
    velocities = [
        (
            f"`{item.velocity_name}`",
            item.velocity_unit,
            _number(task.start[scene.nq + place]),
            goal[scene.nq + place],
            _range(item.velocity_lower, item.velocity_upper),
        )
        for place, item in enumerate(scene.coordinates)
    ]
    text += [
        "## Coordinates\n",
        _table(("name", "unit", "start", "goal", "nominal", "meaning"), coordinates),
    ]
    text.append(_table(("velocity", "unit", "start", "goal", "bounds"), velocities))
    inputs = [
        (f"`{item.name}`", item.unit, _range(item.lower, item.upper), item.description)
        for item in scene.inputs
    ]
    text += [
        "## Inputs\n",
        _table(("name", "unit", "bounds", "meaning"), inputs)
        or "None: there is nothing to plan.\n",
    ]
    contacts = [
        (
            f"`{item.name}`",
            " and ".join(item.bodies),
            f"`{item.penetration}`",
            f"`{item.stiffness}`",
            _damping(item),
            _number(item.nominal),
            f"{depth:g}: {item.depth_reason}",
        )
        for item, depth in zip(scene.contacts, scene.depths, strict=True)
    ]
    text += [
        "## Contacts\n",
        _table(
            (
                "name",
                "between",
                "penetration [m]",
                "stiffness [N/m]",
                "damping",
                "nominal [m]",
                "the model ends at [m]",
            ),
            contacts,
        )
        or "None.\n",
    ]
    frictions = [
        (
            f"`{item.name}`",
            f"`{item.slip}`",
            f"`{item.coefficient}`",
            " + ".join(item.pressing) or f"`{item.normal_force}`",
            _number(item.nominal),
            item.description,
        )
        for item in scene.frictions
    ]
    text += [
        "## Friction\n",
        _table(
            ("name", "slip [m/s]", "mu", "pressed by", "nominal slip [m/s]", "meaning"), frictions
        )
        or "None.\n",
    ]
    parameters = [
        (
            f"`{item.name}`",
            _number(item.value),
            item.unit,
            _range(item.lower, item.upper),
            item.description,
        )
        for item in scene.parameters
    ]
    text += [
        "## Parameters\n",
        _table(("name", "value", "unit", "range", "meaning"), parameters) or "None.\n",
    ]
    limits = [
        (f"`{item.metric}`", "waived" if item.value is None else _number(item.value), item.reason)
        for item in scene.limits
    ]
    text += [
        "## Limits\n",
        _table(("metric", "limit", "reason"), limits) or "None of its own.\n",
        "All other metrics have [the default limits](../metrics.md).\n",
    ]
    answers = [
        (item.quantity, f"{float(item.value):.10g}", _number(item.tolerance), item.source)
        for item in scene.answers
    ]
    text += [
        "## Known answers\n",
        _table(("what", "value", "tolerance", "source"), answers) or "None is stored.\n",
    ]
    text.append("## Equations\n")
    for item in record.equations:
        text.append(
            f"<p>{item.caption}</p>\n<div class='equation' tabindex='0'>{safe_mathml(item.mathml) or item.mathml}</div>\n"
        )
    shapes = [
        (
            item.name,
            item.kind,
            ", ".join(f"`{size}`" for size in item.size),
            f"`{item.x}`",
            f"`{item.y}`",
            f"`{item.angle}`",
        )
        for item in scene.shapes
    ]
    text += [
        "## Shapes\n",
        _table(("name", "kind", "size [m]", "x [m]", "y [m]", "angle [rad]"), shapes) or "None.\n",
    ]
    return "\n".join(text)


def _damping(contact: models.scene.Contact) -> str:
    return (
        "none"
        if not contact.is_damped
        else f"`{contact.damping}` {contact.damping_law.unit}, {contact.damping_law.name.replace('_', ' ').lower()}"
    )


def _methods() -> str:
    text = [
        "# Methods and pipelines\n",
        "A method finds a plan. A pipeline chains methods, each from the plan of the previous one. [A new method](extending.md#a-method) takes one file.\n",
    ]
    pipelines = [
        (
            f"`{item.name}`",
            item.title,
            " → ".join(f"`{leg.method}`" for leg in item.legs),
            item.source,
        )
        for item in PIPELINES
    ]
    text += [
        "## Pipelines\n",
        _table(("name", "what it is", "methods", "source"), pipelines),
        "## Methods\n",
    ]
    for name in method_names():
        method = load_method(name)
        kind = "Exact contact" if method.kind.name == "DIRECT" else "Relaxed contact"
        text.append(
            f"### {name}\n\n{method.title}. {kind}{', at a relaxation eps' if method.needs_eps else ''}.\n"
        )
        options = [
            (
                f"`{item.name}`",
                f"`{item.default}`",
                item.metadata["unit"],
                _choices(item.metadata),
                item.metadata["description"],
            )
            for item in fields(method.options)
        ]
        text.append(
            _table(("option", "default", "unit", "values", "meaning"), options)
            or "It has no options.\n"
        )
    return "\n".join(text)


def _choices(option: Mapping[str, Any]) -> str:
    return ", ".join(f"`{item}`" for item in option["choices"]) or _range(
        option["lower"], option["upper"]
    )


def _metrics() -> str:
    text = [
        "# Metrics and limits\n",
        "Metrics in the order of the questions of [the verdict](verdict.md). A scene, a campaign file and the map of an FMU may limit each metric, except those that are only shown.\n",
    ]
    for question in Question:
        entries = [entry for entry in (*TABLE, *FEEDBACK) if entry.question is question]
        rows = [
            (
                f"`{entry.name}`",
                entry.meaning,
                "only the scene's" if entry.default is None else entry.default[1],
            )
            for entry in entries
        ]
        shown = question is Question.SHOWN
        text += [
            f"## {question.value or 'Shown, and judging nothing'}\n",
            _table(
                ("metric", "meaning")
                if shown
                else ("metric", "meaning", "limit where the scene sets none"),
                [row[:2] if shown else row for row in rows],
            ),
        ]
    return "\n".join(text)


def _touchstone() -> str:
    elsewhere = {name for names in _MODELS.values() for name in names}
    types = [
        ".".join(touchstone._HOME[name])
        for name in touchstone.__all__
        if name in touchstone._HOME and name not in elsewhere
    ]
    functions = [
        f"touchstone.{name}" for name in touchstone.__all__ if name not in touchstone._HOME
    ]
    return (
        _reference("touchstone", functions)
        + "\n## What they give and take\n\nScenes and trajectories are those of [models](models.md).\n\n"
        + _objects(types)
    )


def _home(package, name: str) -> str:
    """Return the module that defines an object of a package."""
    item = getattr(package, name)
    return f"{getattr(item, '__module__', package.__name__)}.{name}"


def _reference(title: str, objects: list[str]) -> str:
    return f"# {title}\n\n{_objects(objects)}"


def _objects(objects: list[str]) -> str:
    return "\n".join(f"::: {name}\n" for name in objects)
