"""Convert `[[plans]]` of a campaign file into scenes: instances of a scene with their plans.

    planned, mistakes = plan_scenes(file.plans, folder)
    references, refused = foreign_references(planned, folder, pipelines)

Each instance becomes a scene with the instance's name, parameters, start and goal. A model of the
plans' own equations gives a second scene with the ending `_own_equations`. A leg that reads the
plan (formulations.given_plan) replaces a pipeline. An instance with a mistake is refused in one
sentence; the other instances run.
"""

from __future__ import annotations

import csv
import glob
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from formulations.given_plan import leg, read_plan
from formulations.method import Pipeline
from formulations.pipelines import pipeline_names
from models.catalog import scene_names
from models.errors import TouchstoneError, did_you_mean
from models.netcdf import read_columns
from models.scene import Scene
from models.scene.checks import check_expressions
from models.scene.text import scene_text
from models.trajectory import Trajectory
from validate.campaign.runs import referred
from validate.campaign.schema import PlansEntry
from validate.judge.score import metric_names
from validate.judge.time_step import load_step, numbers_of, take_step
from validate.tasks.task import SceneReference, Variant, state_names, varied

OWN = "_own_equations"
# Text columns of a CSV of instances.
_NAME, _PLAN = "name", "plan"
# `# instance: a` above the header of a plan.
_DECLARED = re.compile(r"^[\"']?#\s*instance\s*:\s*([\w.-]+)", re.MULTILINE)
_HEAD = 4096  # searched characters of a plan
# Largest difference of equal starts [nominal values], as in question 1 of the judge.
_SAME_START = 1e-6


class InstanceError(TouchstoneError):
    """An instance, or all instances of an entry, that cannot be judged."""


@dataclass(frozen=True)
class PlanScenes:
    """An entry of `[[plans]]` with its scenes.

    Attributes
    ----------
    place
        Place of the entry in the file.
    scenes
        The physics, and the model if the entry has one.
    """

    entry: PlansEntry
    place: str
    scenes: tuple[SceneReference, ...]


@dataclass(frozen=True)
class _Instance:
    """A line of the instances. label: the name as written; values: by column."""

    name: str
    label: str
    plan: Path | None
    values: Mapping[str, str]


def plan_scenes(entries: Sequence[PlansEntry], folder: Path) -> tuple[list[PlanScenes], list[str]]:
    """Load the scenes of the entries.

    Parameters
    ----------
    entries
        Entries of `[[plans]]`.
    folder
        Folder of the campaign file.

    Returns
    -------
    tuple[list[PlanScenes], list[str]]
        Loaded entries, and mistakes that prevent the campaign.
    """
    found, mistakes = [], []
    for index, entry in enumerate(entries):
        place, loaded = f"plans[{index}]", []
        for key, name in (("scene", entry.scene), ("model", entry.model)):
            try:
                if name is not None:
                    loaded.append(referred(str(folder / name) if name.endswith(".py") else name))
            except (TouchstoneError, OSError, ValueError) as error:
                mistakes.append(f"{place}.{key}: {error}")
        for figure in entry.limits:
            if figure not in metric_names():
                hint = did_you_mean(figure, metric_names(), "see docs/verdict.md.")
                mistakes.append(f"{place}.limits.{figure[:80]}: there is no figure of that name; {hint}")  # fmt: skip
        if entry.name in pipeline_names():
            mistakes.append(f"{place}.name: it is a pipeline of ours; choose another name")
        found.append(PlanScenes(entry, place, tuple(loaded)))
    return found, mistakes


def foreign_references(
    planned: Sequence[PlanScenes], folder: Path, pipelines: tuple[Pipeline, ...]
) -> tuple[list[SceneReference], list[str]]:
    """Return the scenes of all instances.

    Parameters
    ----------
    planned
        Entries with their scenes, from `plan_scenes`.
    folder
        Folder of the campaign file.
    pipelines
        Pipelines of the campaign file, which run in addition to the plans.

    Returns
    -------
    tuple[list[SceneReference], list[str]]
        Scenes, and a sentence for each instance that does not run.
    """
    references: list[SceneReference] = []
    refused: list[str] = []
    # Scene text and plan names by instance; an instance may have several plans.
    taken: dict[str, tuple[str, list[str]]] = {name: ("", []) for name in scene_names()}
    for item in planned:
        try:
            instances = _instances(item, folder)
            _check_entry(item, instances, pipelines)
        except InstanceError as error:
            refused.append(f"{item.place}.{error}")
            continue
        made = []
        for instance in instances:
            try:
                one = _Made(item, instance, folder)
                text, plans = taken.setdefault(instance.name, (scene_text(one.scene), []))
                if text != scene_text(one.scene) or item.entry.name in plans:
                    raise InstanceError(
                        "another scene or plan has this name; rename the instance, or name the plans apart (name = ..)."
                    )
                one.run(() if plans else pipelines)
                plans.append(item.entry.name)
                made.append(one)
            except (TouchstoneError, ValueError, OverflowError) as error:
                refused.append(f"instance {instance.name}: {error}")
        for one in made:
            if (other := _started_elsewhere(one, made)) is None:
                references += one.references
            else:
                refused.append(
                    f"instance {one.name}: its plan starts where instance {other} starts, and not where this instance does; check plans and instances."
                )
    return references, refused


def _instances(item: PlanScenes, folder: Path) -> list[_Instance]:
    entry, base = item.entry, item.scenes[0].scene
    if entry.instances is None:
        plans = [Path(found) for found in sorted(glob.glob(str(folder / (entry.plans or ""))))]
        plans = [path for path in plans if path.is_file()]
        if not plans:
            raise InstanceError(
                f'plans: no file matches {entry.plans!r}; give a pattern such as "plans/*.csv", or instances.'
            )
        return [_Instance(_as_name(path.stem, base), path.stem, path, {}) for path in plans]
    path = folder / entry.instances
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = [line for line in csv.reader(file) if any(line) and not line[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InstanceError(f"instances: {path} cannot be read ({error}).") from error
    header = [cell.strip() for cell in lines[0]] if lines else []
    if _NAME not in header or len(lines) < 2:
        raise InstanceError(
            f"instances: {path} needs a header with the column {_NAME!r}, and a line for each instance."
        )
    found = []
    for line in lines[1:]:
        values = dict(zip(header, map(str.strip, line), strict=False))
        label = values.pop(_NAME, "")
        plan = values.pop(_PLAN, "") or (entry.plans or "").replace("{name}", label)
        found.append(_Instance(_as_name(label, base), label, folder / plan if plan else None, values))  # fmt: skip
    return found


def _as_name(text: str, base: Scene) -> str:
    """Return ASCII letters, digits and _; a leading non-letter follows the scene's name."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if re.match(r"[A-Za-z]", name) else f"{base.name}_{name}"


def _check_entry(
    item: PlanScenes, instances: Sequence[_Instance], pipelines: tuple[Pipeline, ...]
) -> None:
    """Raise InstanceError for a mistake that all instances of an entry have."""
    scene, *models = (reference.scene for reference in item.scenes)
    states = state_names(scene)
    known = [parameter.name for parameter in scene.parameters]
    known += [f"{part}.{name}" for part in ("start", "goal") for name in states]
    for column in dict.fromkeys(key for one in instances for key in one.values):
        if column not in known:
            hint = did_you_mean(column, known, f"it has {', '.join(known)}.")
            raise InstanceError(
                f"instances: scene {scene.name} has no parameter or state {column!r}; {hint}"
            )
    for model in models:
        for what in ("coordinates", "inputs"):
            ours, theirs = (
                ", ".join(f"{quantity.name} [{quantity.unit}]" for quantity in getattr(one, what))
                for one in (scene, model)
            )
            if ours != theirs:
                raise InstanceError(
                    f"model: scene {model.name} has the {what} {theirs}, but scene {scene.name} has {ours}; both must be the same."
                )
    if not pipelines and all(one.plan is None for one in instances):
        raise InstanceError("plans: there is neither a plan to judge nor a pipeline to run.")


def _started_elsewhere(one: _Made, made: Sequence[_Made]) -> str | None:
    """Return the other instance at whose start the plan starts, None if there is none."""
    if one.plan is None or not one.plan.has_states:
        return None
    here, nq = one.plan.q[0], one.scene.nq
    same = _SAME_START * np.array([item.nominal for item in one.scene.coordinates])
    starts = {
        other.name: bool((np.abs(here - other.scene.task.start[:nq]) <= same).all())
        for other in made
    }
    return (
        None if starts[one.name] else next((name for name, is_it in starts.items() if is_it), None)
    )


class _Made:
    def __init__(self, item: PlanScenes, instance: _Instance, folder: Path) -> None:
        self.name, self._item, self._instance, self._folder = instance.name, item, instance, folder
        self._variants = [
            self._variant(reference.scene, self.name + ending)
            for reference, ending in zip(item.scenes, ("", OWN), strict=False)
        ]
        self._scenes = [
            varied(reference.scene, variant)
            for reference, variant in zip(item.scenes, self._variants, strict=True)
        ]
        for scene in self._scenes:
            check_expressions(scene)
        self.scene = self._scenes[0]
        self.plan: Trajectory | None = None
        self.references: list[SceneReference] = []

    def _variant(self, base: Scene, name: str) -> Variant:
        entry, numbers = self._item.entry, {}
        for column, text in self._instance.values.items():
            try:
                numbers[column] = float(text)
            except ValueError:
                raise InstanceError(f"{column} is {text!r}, expected a number.") from None

        def section(part: str) -> dict[str, float]:
            named = {column.partition(".")[::2]: value for column, value in numbers.items()}
            return {name: value for (first, name), value in named.items() if first == part}

        return Variant(
            name=name,
            parameters={
                parameter.name: numbers[parameter.name]
                for parameter in base.parameters
                if parameter.name in numbers
            },
            start=section("start"),
            goal=dict(section("goal")),
            steps=entry.steps,
            step=entry.step,
            limits={key: (limit.value, limit.reason) for key, limit in entry.limits.items()},
        )

    def run(self, pipelines: tuple[Pipeline, ...]) -> None:
        """Plan the runs: the given plan on each scene, the pipelines on the first."""
        entry, given = self._item.entry, ()
        if self._instance.plan is not None or entry.plans is not None:
            given = (self._given(self._instance.plan),)
        if entry.start is not None:
            path = self._folder / entry.start.replace("{name}", self._instance.label)
            first = leg(path, self._written_for(path))
            read_plan(path, self.scene, str(first.options["of"]))
            pipelines = tuple(
                replace(way, title=f"{way.title}, from {path.name}", legs=(first, *way.legs))
                for way in pipelines
            )
        for index, base in enumerate(self._item.scenes[: 2 if given else 1]):
            self.references.append(
                replace(
                    base,
                    scene=self._scenes[index],
                    variant=self._variants[index],
                    instance=self.name,
                    judged_by=("scene", "model")[index],
                    pipelines=given if index else (*given, *pipelines),
                )
            )

    def _given(self, path: Path | None) -> Pipeline:
        if path is None or not os.path.isfile(path):
            raise InstanceError(f"its plan {path or ''} is missing; check plans and instances.")
        of, time_step, entry = self._written_for(path), "", self._item.entry
        self.plan, *_ = (read_plan(path, scene, of) for scene in self._scenes)
        if entry.time_step is not None:
            time_step, plan = str((self._folder / entry.time_step).resolve()), self.plan
            h, numbers = float(plan.t[1] - plan.t[0]), numbers_of(self.scene)
            # Raises for an invalid time step before any task runs.
            take_step(self.scene, load_step(time_step), plan.q[0], plan.v[0], plan.u[0], h, numbers)
        return Pipeline(name=entry.name, title=path.name, legs=(leg(path, of, time_step),))

    def _written_for(self, path: Path) -> str:
        """Return the scene that a NetCDF plan states, "" for a CSV. Raises InstanceError."""
        known = {self.name, self._instance.label}
        if path.suffix == ".nc":
            stated = str(read_columns(path)[1].get("scene", ""))
            known.add(self._item.scenes[0].scene.name)
        elif not os.path.isfile(path):
            raise InstanceError(f"its start {path} is missing; check start.")
        else:
            with open(path, encoding="utf-8", errors="replace") as file:
                found = _DECLARED.search(file.read(_HEAD))
            if found is None:
                return ""
            stated = found.group(1)
        if stated not in known:
            raise InstanceError(
                f"plan {path} states that it is of {stated!r}, not of this instance; check plans and instances."
            )
        return stated if path.suffix == ".nc" else ""
