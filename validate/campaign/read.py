"""Read a campaign file, completely or not at all.

    run_campaign(read_campaign(Path("stiffness.toml"), out=out), narrator)

All mistakes of a file are reported at once, with their places. Pipelines are built in, or defined
in the file. Scenes are loaded, changed and named, one for each combination of swept values.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from formulations.method import Leg, Method, Pipeline
from formulations.pipelines import PIPELINES
from models.catalog import scene_names
from models.errors import TouchstoneError, did_you_mean
from models.scene import Scene
from models.scene.checks import check_expressions
from validate.campaign.foreign import foreign_references, plan_scenes
from validate.campaign.runs import CampaignSettings, referred
from validate.campaign.schema import (
    FREE,
    CampaignFile,
    CampaignLimit,
    LegEntry,
    PipelineEntry,
    PlansEntry,
    SceneEntry,
    resolved_text,
)
from validate.judge.score import metric_names
from validate.processes.toml_text import TomlError, mistake, read_toml
from validate.tasks.plugins import DEFAULT_PLUGIN, load_plugin
from validate.tasks.task import SceneReference, Variant, state_names, varied

# Copy of the campaign file, stored with the results.
GIVEN = "campaign.toml"
# Campaign file with all defaults, stored with the results.
RESOLVED = "resolved.toml"
# Largest number of printed mistakes.
MOST_SHOWN = 50
SOURCE = "a campaign file"
_LONGEST_NAME = 60
# Largest number of scenes in a sweep; more are probably a typing error. At 1 s a task, 1000 scenes
# run for a quarter of an hour with each pipeline.
MOST_VARIANTS = 1000
_Place = tuple[str | int, ...]
_Change = tuple[str, str]  # section (or steps, step) and name


class ConfigError(TouchstoneError):
    """A campaign file with mistakes.

    `mistakes` contains a sentence for each mistake, beginning with its place in the file.
    """

    def __init__(self, path: Path, mistakes: list[str]) -> None:
        shown = mistakes[:MOST_SHOWN] + (
            [f"and {len(mistakes) - MOST_SHOWN} more"] if len(mistakes) > MOST_SHOWN else []
        )
        self.mistakes = tuple(" ".join(mistake.split()) for mistake in shown)
        count = f"{len(mistakes)} mistakes" if len(mistakes) > 1 else "a mistake"
        self.headline = (
            f"campaign {path}: there {'are' if len(mistakes) > 1 else 'is'} {count} in it"
        )
        super().__init__(f"{self.headline}: {'; '.join(self.mistakes)}")


def read_campaign(
    path: Path, *, out: Path | None = None, plugin: str = DEFAULT_PLUGIN, **given: Any
) -> CampaignSettings:
    """Read and check a campaign file.

    out: the default is runs/NAME of the file.
    given: fields of the settings that a file does not set.

    Raises ConfigError with every mistake, UnknownNameError for `plugin`.
    """
    loaded = load_plugin(plugin)
    try:
        text, data = read_toml(path)
    except TomlError as error:
        raise ConfigError(path, [str(error)]) from error
    file, mistakes = _checked(data)
    if file is None:
        raise ConfigError(path, mistakes)
    scenes, bases, wrong = _references(file.scenes, path.parent)
    mistakes += wrong
    if not (file.scenes or file.plans or mistakes):
        mistakes.append("scenes: there is none; name scenes to plan for, or plans ([[plans]])")
    planned, wrong = plan_scenes(file.plans, path.parent)
    mistakes += wrong
    bases += [scene for entry in planned for scene in entry.scenes]
    # All pipelines for these scenes; all built-in pipelines if no scene can be read.
    known = {
        pipeline.name: pipeline
        for reference in bases
        for pipeline in loaded.pipelines_for(reference.scene)
    }
    # A pipeline that runs by default on one scene only can be selected for every scene.
    ours = {pipeline.name: pipeline for pipeline in PIPELINES if not known or pipeline.only}
    pipelines, wrong = _chosen_pipelines(file, {**ours, **known}, loaded.load_method)
    mistakes += wrong
    if mistakes:
        raise ConfigError(path, mistakes)
    foreign, refused = foreign_references(planned, path.parent, pipelines)
    if refused and not (foreign or scenes):
        raise ConfigError(path, refused)
    return CampaignSettings(
        out=out or Path("runs") / path.stem,
        plugin=plugin,
        chosen=(*scenes, *foreign),
        refused=tuple(refused),
        pipelines=pipelines,
        checked=tuple(bases) if file.checks else (),
        time_limit=file.time_limit,
        title=file.title,
        files={
            GIVEN: text,
            RESOLVED: resolved_text(file, scenes, loaded.load_method, path.name, path.parent),
        },
        **given,
    )


def _hint(name: str, known: Iterable[str]) -> str:
    """Return `did you mean k?`, or all known names."""
    known = list(known)
    return did_you_mean(
        name, known, f"there are {', '.join(known)}." if known else "there are none."
    )


def _place_text(place: Sequence[str | int]) -> str:
    """Return a place as `scenes[0].parameters.k`."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part[:80]}" if text else part[:80]
    return text


def _checked(data: dict[str, Any]) -> tuple[CampaignFile | None, list[str]]:
    """Return the valid part of the file, None if there is none, and all mistakes.

    The caller checks the valid part further.
    """
    try:
        return CampaignFile.model_validate(data), []
    except ValidationError as error:
        problems = error.errors(include_url=False)
    mistakes = [_sentence(problem) for problem in problems]
    for _ in range(10):  # a mistake may hide further mistakes
        for problem in problems:
            _remove(data, problem["loc"])
        try:
            return CampaignFile.model_validate(data), mistakes
        except ValidationError as error:
            problems = error.errors(include_url=False)
    return None, mistakes


def _sentence(problem: Any) -> str:
    place, where = problem["loc"], _place_text(problem["loc"])
    if problem["type"] == "extra_forbidden":
        return (
            f"{where}: there is no such key; {_hint(str(place[-1]), _model_at(place).model_fields)}"
        )
    return f"{where}: {mistake(problem)}"


def _model_at(place: _Place) -> type[BaseModel]:
    """Return the model that the last part of this place is a key of."""
    if len(place) == 1:
        return CampaignFile
    if place[0] in ("scenes", "plans"):
        entry = SceneEntry if place[0] == "scenes" else PlansEntry
        return entry if len(place) == 3 else CampaignLimit
    return PipelineEntry if len(place) == 3 else LegEntry


def _remove(data: Any, place: _Place) -> None:
    """Delete the item at this place, or its parent if the item is missing.

    Lists are emptied, so that indices stay valid.
    """
    way = [data]
    for part in place:
        inside = _inside(way[-1], part)
        if inside is None:
            break
        way.append(inside)
    depth = max(len(way) - 2, 0)
    holder = way[depth]
    if isinstance(holder, dict):
        holder.pop(place[depth], None)
    elif isinstance(holder, list):
        holder.clear()


def _inside(data: Any, part: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(part)
    return (
        data[part]
        if isinstance(data, list) and isinstance(part, int) and part < len(data)
        else None
    )


def _chosen_pipelines(
    file: CampaignFile, known: Mapping[str, Pipeline], load_method: Callable[[str], Method]
) -> tuple[tuple[Pipeline, ...], list[str]]:
    """Return the pipelines to run, none for all known pipelines, and mistakes."""
    mistakes: list[str] = []
    own: dict[str, Pipeline] = {}
    for name, entry in file.pipeline.items():
        wrong = [*_name_mistakes(name, known), *_leg_mistakes(entry, load_method)]
        mistakes += [f"pipeline.{name[:_LONGEST_NAME]}{sentence}" for sentence in wrong]
        own[name] = Pipeline(
            name=name,
            title=entry.title or name,
            legs=tuple(_leg(leg) for leg in entry.legs),
            source=SOURCE,
        )
    names = file.pipelines or list(own)
    for place, name in enumerate(names):
        if name not in known and name not in own:
            mistakes.append(
                f"pipelines[{place}]: there is no pipeline {name[:80]!r}; {_hint(name, [*own, *known])}"
            )
        elif name in names[:place]:
            mistakes.append(f"pipelines[{place}]: {name!r} stands there twice")
    if mistakes:
        return (), mistakes
    return tuple(own.get(name) or known[name] for name in names), []


def _name_mistakes(name: str, known: Mapping[str, Pipeline]) -> Iterator[str]:
    if name in known:
        yield ": it is a pipeline of ours; choose another name"
    if not name.isprintable() or name != name.strip() or not 0 < len(name) <= _LONGEST_NAME:
        yield f": a name is 1 to {_LONGEST_NAME} letters, digits and signs, without blanks at its ends"


def _leg_mistakes(entry: PipelineEntry, load_method: Callable[[str], Method]) -> Iterator[str]:
    for place, leg in enumerate(entry.legs):
        where = f".legs[{place}]"
        try:
            method = load_method(leg.method)
        except (TouchstoneError, KeyError) as error:
            yield f"{where}.method: {error if isinstance(error, TouchstoneError) else f'there is no method {leg.method!r}'}"
            continue
        if method.needs_eps and not leg.eps:
            yield f"{where}.eps: method {leg.method} needs a schedule, such as eps = [1e-3, 1e-5]"
        for number, eps in enumerate(leg.eps):
            yield from _refused(f"{where}.eps[{number}]", method.check_eps, eps)
        stages = len(leg.eps) or 1
        if len(leg.stage_options) > stages:
            yield f"{where}.stage_options: they are for {len(leg.stage_options)} stages, but there {'is' if stages == 1 else 'are'} {stages}"
        yield from (f"{where}.{sentence}" for sentence in _option_mistakes(leg, method))


def _option_mistakes(leg: LegEntry, method: Method) -> Iterator[str]:
    sections = {
        "options": leg.options,
        **{f"stage_options[{number}]": own for number, own in enumerate(leg.stage_options)},
    }
    single = [
        sentence
        for section, options in sections.items()
        for name, value in options.items()
        for sentence in _refused(f"{section}.{name[:80]}", method.read_options, {name: value})
    ]
    yield from single
    if not single:  # options that are invalid only together
        for section, options in sections.items():
            yield from _refused(section, method.read_options, {**leg.options, **options})


def _refused(where: str, check: Callable[[Any], Any], value: Any) -> Iterator[str]:
    try:
        check(value)
    except (TouchstoneError, TypeError, ValueError, OverflowError) as error:
        yield f"{where}: {error}"


def _leg(entry: LegEntry) -> Leg:
    return Leg(
        method=entry.method,
        schedule=tuple(entry.eps) or (None,),
        options=dict(entry.options),
        stage_options=tuple(dict(options) for options in entry.stage_options),
    )


def _references(
    entries: Sequence[SceneEntry], folder: Path
) -> tuple[list[SceneReference], list[SceneReference], list[str]]:
    """Return the scenes with their variants in order, the unchanged scenes, and mistakes.

    folder: base of relative paths.
    """
    found: list[SceneReference] = []
    bases: dict[str, SceneReference] = {}
    mistakes: list[str] = []
    for place, entry in enumerate(entries):
        where = f"scenes[{place}]"
        try:
            base = referred(
                str(folder / entry.scene) if entry.scene.endswith(".py") else entry.scene
            )
        except (TouchstoneError, OSError, ValueError) as error:
            mistakes.append(f"{where}.scene: {error}")
            continue
        bases.setdefault(base.where, base)
        wrong = list(_scene_mistakes(entry, base.scene))
        if not wrong:
            made, wrong = _variants(entry, base)
            found += made
        mistakes += [f"{where}.{sentence}" for sentence in wrong]
    names = [reference.scene.name for reference in found]
    mistakes += [
        f"scenes: {names.count(name)} of them are called {name!r}; give them names of their own (name = ...)"
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    return found, list(bases.values()), mistakes


def _scene_mistakes(entry: SceneEntry, scene: Scene) -> Iterator[str]:
    if entry.name in scene_names():
        yield f"name: {entry.name!r} is a scene of ours; choose another name"
    parameters = {item.name: item for item in scene.parameters}
    for name, values in entry.parameters.items():
        if name not in parameters:
            yield f"parameters.{name[:80]}: scene {scene.name} has no such parameter; {_hint(name, parameters)}"
            continue
        for value in values:
            try:
                replace(parameters[name], value=value)
            except TouchstoneError as error:
                yield f"parameters.{name}: {error}"
    for section, given in (("start", entry.start), ("goal", entry.goal)):
        for name in given:
            if name not in state_names(scene):
                yield f"{section}.{name[:80]}: scene {scene.name} has no such coordinate or velocity; {_hint(name, state_names(scene))}"
    for figure in entry.limits:
        if figure not in metric_names():
            yield f"limits.{figure[:80]}: there is no figure of that name; {_hint(figure, metric_names())}"
    lengths = [len(values) for values in _changes(entry).values() if len(values) > 1]
    if entry.sweep == "together" and len(set(lengths)) > 1:
        yield f'sweep: "together" needs lists of one length, but theirs are {", ".join(map(str, lengths))}'
    elif (
        count := lengths[0] if entry.sweep == "together" and lengths else math.prod(lengths)
    ) > MOST_VARIANTS:
        yield f"sweep: these lists give {count} scenes, more than {MOST_VARIANTS}; leave out some values"


def _changes(entry: SceneEntry) -> dict[_Change, list[Any]]:
    sections = {"parameters": entry.parameters, "start": entry.start, "goal": entry.goal}
    changes: dict[_Change, list[Any]] = {
        (part, name): values for part, given in sections.items() for name, values in given.items()
    }
    changes |= {} if entry.steps is None else {("steps", ""): entry.steps}
    return changes | ({} if entry.step is None else {("step", ""): entry.step})


def _variants(entry: SceneEntry, base: SceneReference) -> tuple[list[SceneReference], list[str]]:
    changes = _changes(entry)
    if not changes and not entry.limits and entry.name is None:
        return [base], []
    found, mistakes = [], []
    for values in _combinations(list(changes.values()), entry.sweep):
        chosen = dict(zip(changes, values, strict=True))
        variant = _variant(_name(entry, base.scene, changes, chosen), chosen, entry)
        try:
            changed = varied(base.scene, variant)
            check_expressions(changed)
            found.append(SceneReference(base.where, changed, variant))
        except (TouchstoneError, ValueError, OverflowError) as error:
            mistakes.append(f"scene: {variant.name}: {error}")
    return found, mistakes


def _combinations(lists: Sequence[Sequence[Any]], sweep: str) -> Iterator[tuple[Any, ...]]:
    if sweep == "product":
        yield from itertools.product(*lists)
        return
    longest = max((len(values) for values in lists), default=1)
    yield from zip(
        *(list(values) * (longest if len(values) == 1 else 1) for values in lists), strict=True
    )


def _variant(name: str, chosen: Mapping[_Change, Any], entry: SceneEntry) -> Variant:
    def section(wanted: str) -> dict[str, Any]:
        return {name: value for (part, name), value in chosen.items() if part == wanted}

    return Variant(
        name=name,
        parameters={name: float(value) for name, value in section("parameters").items()},
        steps=chosen.get(("steps", "")),
        step=None if ("step", "") not in chosen else float(chosen["step", ""]),
        start={name: float(value) for name, value in section("start").items()},
        goal={
            name: None if value == FREE else float(value) for name, value in section("goal").items()
        },
        limits={
            figure: (float(limit.value), limit.reason) for figure, limit in entry.limits.items()
        },
    )


def _name(
    entry: SceneEntry,
    scene: Scene,
    changes: Mapping[_Change, Sequence[Any]],
    chosen: Mapping[_Change, Any],
) -> str:
    """Return a name such as `three_cart_k_300`.

    The entry's name precedes the swept values; without it, the scene's name precedes all changes.
    """
    distinct = [change for change in changes if entry.name is None or len(changes[change]) > 1]
    parts = [entry.name or scene.name]
    for section, name in distinct:
        parts += [
            word
            for word in (
                "" if section == "parameters" else section,
                name,
                _letters(chosen[section, name]),
            )
            if word
        ]
    if entry.name is None and not changes:
        parts.append("limits")
    return "_".join(parts)


def _letters(value: Any) -> str:
    """Return a number as letters and digits: 0.25 -> 0p25, -1 -> m1."""
    text = value if isinstance(value, str) else format(value, ".12g")
    return text.replace("-", "m").replace(".", "p").replace("+", "")
