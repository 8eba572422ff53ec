"""The scenes of a campaign file: loaded, changed and named, one for each combination of swept values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.catalog import load_scene, scene_names, scene_path
from models.errors import TouchstoneError
from models.scene import Scene
from models.scene.checks import check_expressions
from validate.judge.score import check_limits, metric_names
from validate.plan.mistakes import hint
from validate.plan.schema import FREE, SceneEntry
from validate.tasks.variant import SceneReference, Variant, state_names, varied

# A sweep of more is a slip of the pen: at a second a task it would run for a quarter of an hour by each pipeline.
MOST_VARIANTS = 1000
_Change = tuple[str, str]  # section (or steps, step) and name


def references(entries: Sequence[SceneEntry], folder: Path) -> tuple[list[SceneReference], list[SceneReference], list[str]]:
    """Scenes in order with their variants, the unchanged scenes they come from, and mistakes. folder: from which paths are looked up."""
    found: list[SceneReference] = []
    bases: dict[str, SceneReference] = {}
    mistakes: list[str] = []
    for place, entry in enumerate(entries):
        where = f"scenes[{place}]"
        path = str(folder / entry.scene) if entry.scene.endswith(".py") else entry.scene
        try:
            scene = load_scene(path)
            check_limits(scene, scene_path(path))
        except (TouchstoneError, OSError, ValueError) as error:
            mistakes.append(f"{where}.scene: {error}")
            continue
        reference = str(Path(path).resolve()) if entry.scene.endswith(".py") else entry.scene
        bases.setdefault(reference, SceneReference(reference, scene))
        wrong = list(_mistakes(entry, scene))
        if not wrong:
            made, wrong = _variants(entry, scene, reference)
            found += made
        mistakes += [f"{where}.{sentence}" for sentence in wrong]
    names = [reference.scene.name for reference in found]
    mistakes += [
        f"scenes: {names.count(name)} of them are called {name!r}; give them names of their own (name = ...)"
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    return found, list(bases.values()), mistakes


def _mistakes(entry: SceneEntry, scene: Scene) -> Iterator[str]:
    """What this entry asks of its scene that the scene does not have."""
    if entry.name in scene_names():
        yield f"name: {entry.name!r} is a scene of ours; choose another name"
    parameters = {item.name: item for item in scene.parameters}
    for name, values in entry.parameters.items():
        if name not in parameters:
            yield f"parameters.{name[:80]}: scene {scene.name} has no such parameter; {hint(name, parameters)}"
            continue
        for value in values:
            try:
                replace(parameters[name], value=value)
            except TouchstoneError as error:
                yield f"parameters.{name}: {error}"
    for section, given in (("start", entry.start), ("goal", entry.goal)):
        for name in given:
            if name not in state_names(scene):
                yield f"{section}.{name[:80]}: scene {scene.name} has no such coordinate or velocity; {hint(name, state_names(scene))}"
    for figure in entry.limits:
        if figure not in metric_names():
            yield f"limits.{figure[:80]}: there is no figure of that name; {hint(figure, metric_names())}"
    lengths = [len(values) for values in _changes(entry).values() if len(values) > 1]
    if entry.sweep == "together" and len(set(lengths)) > 1:
        yield f'sweep: "together" needs lists of one length, but theirs are {", ".join(map(str, lengths))}'
    elif (count := lengths[0] if entry.sweep == "together" and lengths else math.prod(lengths)) > MOST_VARIANTS:
        yield f"sweep: these lists give {count} scenes, more than {MOST_VARIANTS}; leave out some values"


def _changes(entry: SceneEntry) -> dict[_Change, list[Any]]:
    """Everything that is changed, by section and name, with its values."""
    changes: dict[_Change, list[Any]] = {("parameters", name): list(values) for name, values in entry.parameters.items()}
    changes |= {("start", name): list(values) for name, values in entry.start.items()}
    changes |= {("goal", name): list(values) for name, values in entry.goal.items()}
    changes |= {} if entry.steps is None else {("steps", ""): list(entry.steps)}
    return changes | ({} if entry.step is None else {("step", ""): list(entry.step)})


def _variants(entry: SceneEntry, scene: Scene, reference: str) -> tuple[list[SceneReference], list[str]]:
    changes = _changes(entry)
    if not changes and not entry.limits and entry.name is None:
        return [SceneReference(reference, scene)], []
    found, mistakes = [], []
    for values in _combinations(list(changes.values()), entry.sweep):
        chosen = dict(zip(changes, values, strict=True))
        variant = _variant(_name(entry, scene, changes, chosen), chosen, entry)
        try:
            changed = varied(scene, variant)
            check_expressions(changed)
            found.append(SceneReference(reference, changed, variant))
        except (TouchstoneError, ValueError, OverflowError) as error:
            mistakes.append(f"scene: {variant.name}: {error}")
    return found, mistakes


def _combinations(lists: Sequence[Sequence[Any]], sweep: str) -> Iterator[tuple[Any, ...]]:
    if sweep == "product":
        yield from itertools.product(*lists)
        return
    longest = max((len(values) for values in lists), default=1)
    yield from zip(*(list(values) * (longest if len(values) == 1 else 1) for values in lists), strict=True)


def _variant(name: str, chosen: Mapping[_Change, Any], entry: SceneEntry) -> Variant:
    def section(wanted: str) -> dict[str, Any]:
        return {name: value for (part, name), value in chosen.items() if part == wanted}

    return Variant(
        name=name,
        parameters={name: float(value) for name, value in section("parameters").items()},
        steps=chosen.get(("steps", "")),
        step=None if ("step", "") not in chosen else float(chosen["step", ""]),
        start={name: float(value) for name, value in section("start").items()},
        goal={name: None if value == FREE else float(value) for name, value in section("goal").items()},
        limits={figure: (float(limit.value), limit.reason) for figure, limit in entry.limits.items()},
    )


def _name(entry: SceneEntry, scene: Scene, changes: Mapping[_Change, Sequence[Any]], chosen: Mapping[_Change, Any]) -> str:
    """`three_cart_k_300`: the name given or the scene's, then what tells its scenes apart (without a name given: all that is changed)."""
    distinct = [change for change in changes if entry.name is None or len(changes[change]) > 1]
    parts = [entry.name or scene.name]
    for section, name in distinct:
        parts += [word for word in ("" if section == "parameters" else section, name, _letters(chosen[section, name])) if word]
    if entry.name is None and not changes:
        parts.append("limits")
    return "_".join(parts)


def _letters(value: Any) -> str:
    """A number as letters and digits: 0.25 -> 0p25, -1 -> m1."""
    text = value if isinstance(value, str) else format(value, ".12g")
    return text.replace("-", "m").replace(".", "p").replace("+", "")
