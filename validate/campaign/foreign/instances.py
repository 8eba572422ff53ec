"""`[[plans]]` of a campaign file: instances of a scene, with their plans, as scenes of the campaign.

    planned, mistakes = plan_scenes(file.plans, folder)
    references, refused = foreign_references(planned, folder, pipelines)

Each instance becomes a scene with the instance's name, parameters, start and goal, and, if there is
a model of the plans' own equations, a second scene with the ending `_own_equations`. A leg that
reads the plan (formulations.given_plan) takes the place of a pipeline. An instance with a mistake is
refused in one sentence; the other instances run.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
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
from validate.tasks.task import JudgedBy, SceneReference, Variant, state_names, varied

OWN = "_own_equations"
# Columns of a CSV of instances that are no numbers.
_NAME, _PLAN = "name", "plan"
# `# instance: a` above the header of a plan.
_DECLARED = re.compile(r"^[\"']?#\s*instance\s*:\s*([\w.-]+)", re.MULTILINE)
_HEAD = 4096  # characters in which that is looked for
# Two starts are equal up to this share of the nominal, as in question 1 of the judge.
_SAME_START = 1e-6


class InstanceError(TouchstoneError):
    """An instance, or all instances of an entry, that cannot be judged."""


@dataclass(frozen=True)
class PlanScenes:
    """An entry of `[[plans]]` and its scenes. place: in the file."""

    entry: PlansEntry
    place: str
    scene: SceneReference
    model: SceneReference | None

    @property
    def scenes(self) -> tuple[SceneReference, ...]:
        """The scene, and the model if there is one."""
        return (self.scene,) if self.model is None else (self.scene, self.model)


@dataclass(frozen=True)
class _Instance:
    """A line of the instances. values: by column."""

    name: str
    plan: Path | None
    values: Mapping[str, str]


def plan_scenes(entries: Sequence[PlansEntry], folder: Path) -> tuple[list[PlanScenes], list[str]]:
    """Load the scenes of the entries; return them, and the mistakes for which nothing can run."""
    found, mistakes = [], []
    for index, entry in enumerate(entries):
        place, loaded = f"plans[{index}]", {}
        for key in ("scene", "model"):
            name = getattr(entry, key)
            try:
                loaded[key] = None if name is None else referred(_located(folder, name))
            except (TouchstoneError, OSError, ValueError) as error:
                mistakes.append(f"{place}.{key}: {error}")
        mistakes += [
            f"{place}.limits.{figure[:80]}: there is no figure of that name; {did_you_mean(figure, metric_names(), 'see docs/verdict.md.')}"
            for figure in entry.limits
            if figure not in metric_names()
        ]
        if entry.name in pipeline_names():
            mistakes.append(f"{place}.name: it is a pipeline of ours; choose another name")
        if len(loaded) == 2:
            found.append(PlanScenes(entry, place, loaded["scene"], loaded["model"]))
    return found, mistakes


def _located(folder: Path, name: str) -> str:
    return str(folder / name) if name.endswith(".py") else name


def foreign_references(
    planned: Sequence[PlanScenes], folder: Path, pipelines: tuple[Pipeline, ...]
) -> tuple[list[SceneReference], list[str]]:
    """Return the scenes of all instances, and a sentence for each instance that does not run.

    pipelines: of the campaign file, which run beside the plans.
    """
    references: list[SceneReference] = []
    refused: list[str] = []
    taken = _Names()
    for item in planned:
        try:
            instances = _instances(item, folder)
            _check_entry(item, instances, pipelines)
        except InstanceError as error:
            refused.append(f"{item.place}.{error}")
            continue
        starts = _Starts()
        made = []
        for instance in instances:
            try:
                made.append(_Made(item, instance, folder, pipelines, taken))
                starts.add(made[-1])
            except (TouchstoneError, ValueError, OverflowError) as error:
                refused.append(f"instance {instance.name}: {error}")
        for one in made:
            try:
                starts.check(one)
                references += one.references
            except InstanceError as error:
                refused.append(f"instance {one.instance.name}: {error}")
    return references, refused


def _instances(item: PlanScenes, folder: Path) -> list[_Instance]:
    """Return the instances of an entry. Raises InstanceError."""
    entry, base = item.entry, item.scene.scene
    if entry.instances is None:
        pattern = entry.plans or ""
        try:
            plans = sorted(path for path in folder.glob(pattern) if path.is_file())
        except (ValueError, NotImplementedError):
            plans = sorted(Path("/").glob(pattern.lstrip("/"))) if pattern else []
        if not plans:
            raise InstanceError(
                f'plans: no file matches {pattern!r}; give a pattern such as "plans/*.csv", or instances.'
            )
        return [_Instance(_as_name(path.stem, base), path, {}) for path in plans]
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
        name = _as_name(values.pop(_NAME, ""), base)
        plan = values.pop(_PLAN, "") or (entry.plans or "").replace("{name}", line[header.index(_NAME)].strip())  # fmt: skip
        found.append(_Instance(name, folder / plan if plan else None, values))
    return found


def _as_name(text: str, base: Scene) -> str:
    """Return a name of ASCII letters, digits and _; one that begins with a digit follows the scene's."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if re.match(r"[A-Za-z]", name) else f"{base.name}_{name}"


def _check_entry(
    item: PlanScenes, instances: Sequence[_Instance], pipelines: tuple[Pipeline, ...]
) -> None:
    """Raise InstanceError for a mistake that all instances of an entry have."""
    scene, columns = item.scene.scene, dict.fromkeys(key for one in instances for key in one.values)
    known = _columns(scene)
    for column in columns:
        if column not in known:
            hint = did_you_mean(column, known, f"it has {', '.join(known)}.")
            raise InstanceError(
                f"instances: scene {scene.name} has no parameter or state {column!r}; {hint}"
            )
    if item.model is not None:
        for what in ("coordinates", "inputs"):
            ours, theirs = (_quantities(each.scene, what) for each in item.scenes)
            if ours != theirs:
                raise InstanceError(
                    f"model: scene {item.model.scene.name} has the {what} {theirs}, but scene {scene.name} has {ours}; both must be the same."
                )
    if item.entry.plans is None and not pipelines and all(one.plan is None for one in instances):
        raise InstanceError("plans: there is neither a plan to judge nor a pipeline to run.")


def _columns(scene: Scene) -> list[str]:
    states = state_names(scene)
    return [
        *(item.name for item in scene.parameters),
        *(f"{part}.{name}" for part in ("start", "goal") for name in states),
    ]


def _quantities(scene: Scene, what: str) -> str:
    return ", ".join(f"{item.name} [{item.unit}]" for item in getattr(scene, what))


class _Made:
    """An instance as scenes of the campaign. Raises TouchstoneError."""

    def __init__(
        self,
        item: PlanScenes,
        instance: _Instance,
        folder: Path,
        pipelines: tuple[Pipeline, ...],
        taken: _Names,
    ) -> None:
        self.instance, self._item, self._folder = instance, item, folder
        self.scene = self._varied(item.scene.scene, instance.name)
        is_new = taken.take(self.scene, item.entry.name)
        model = None
        if item.model is not None:
            model = self._varied(item.model.scene, instance.name + OWN)
        self.plan: Trajectory | None = None
        given: tuple[Pipeline, ...] = ()
        if item.entry.plans is not None or instance.plan is not None:
            self.plan, given = self._given(model)
        others = self._started(pipelines) if is_new else ()
        self.references = [self._reference(item.scene, self.scene, "scene", (*given, *others))]
        if item.model is not None and model is not None and given:
            self.references.append(self._reference(item.model, model, "model", given))

    def _varied(self, base: Scene, name: str) -> Scene:
        changed = varied(base, self._variant(base, name))
        check_expressions(changed)
        return changed

    def _variant(self, base: Scene, name: str) -> Variant:
        entry, numbers = self._item.entry, dict(self._numbers())
        parameters = {item.name for item in base.parameters}
        states = {
            part: {
                key.partition(".")[2]: value
                for key, value in numbers.items()
                if key.startswith(f"{part}.")
            }
            for part in ("start", "goal")
        }
        return Variant(
            name=name,
            parameters={key: value for key, value in numbers.items() if key in parameters},
            steps=entry.steps,
            step=entry.step,
            limits={key: (limit.value, limit.reason) for key, limit in entry.limits.items()},
            **states,
        )

    def _numbers(self) -> Iterator[tuple[str, float]]:
        for column, text in self.instance.values.items():
            try:
                yield column, float(text)
            except ValueError:
                raise InstanceError(f"{column} is {text!r}, expected a number.") from None

    def _given(self, model: Scene | None) -> tuple[Trajectory, tuple[Pipeline, ...]]:
        """Read the plan on each scene, and return it with its pipeline."""
        entry, path = self._item.entry, self.instance.plan
        if path is None or not path.is_file():
            raise InstanceError(f"its plan {path or ''} is missing; check plans and instances.")
        of = self._written_for(path)
        plans = [read_plan(path, each, of) for each in (self.scene, model) if each is not None]
        time_step = ""
        if entry.time_step is not None:
            time_step = str((self._folder / entry.time_step).resolve())
            self._try_step(time_step, plans[0])
        read = Pipeline(name=entry.name, title=path.name, legs=(leg(path, of, time_step),))
        return plans[0], (read,)

    def _written_for(self, path: Path) -> str:
        """Return the name of the scene that a NetCDF plan states, "" of a CSV. Raises InstanceError."""
        if path.suffix == ".nc":
            stated = str(read_columns(path)[1].get("scene", ""))
            known = {self.instance.name, self.scene.name, self._item.scene.scene.name}
        else:
            with open(path, encoding="utf-8", errors="replace") as file:
                found = _DECLARED.search(file.read(_HEAD))
            if found is None:
                return ""
            stated, known = found.group(1), {self.instance.name}
            known |= {self.instance.name.removeprefix(f"{self._item.scene.scene.name}_")}
        if stated not in known:
            raise InstanceError(
                f"plan {path} states that it is of {stated!r}, not of this instance; check plans and instances."
            )
        return stated if path.suffix == ".nc" else ""

    def _try_step(self, reference: str, plan: Trajectory) -> None:
        """Call the time step once with this instance's numbers. Raises StepError."""
        h = float(plan.t[1] - plan.t[0])
        take_step(self.scene, load_step(reference), plan.q[0], plan.v[0], plan.u[0], h, numbers_of(self.scene))  # fmt: skip

    def _started(self, pipelines: tuple[Pipeline, ...]) -> tuple[Pipeline, ...]:
        """The campaign's pipelines, each from the start plan if there is one."""
        start = self._item.entry.start
        if start is None:
            return pipelines
        path = self._folder / start.replace("{name}", self.instance.name)
        if not path.is_file():
            raise InstanceError(f"its start {path} is missing; check start.")
        first = leg(path, self._written_for(path))
        read_plan(path, self.scene, str(first.options["of"]))
        return tuple(
            replace(
                pipeline, title=f"{pipeline.title}, from {path.name}", legs=(first, *pipeline.legs)
            )
            for pipeline in pipelines
        )

    def _reference(
        self, base: SceneReference, scene: Scene, by: JudgedBy, pipelines: tuple[Pipeline, ...]
    ) -> SceneReference:
        variant = self._variant(base.scene, scene.name)
        return SceneReference(base.where, scene, variant, self.instance.name, by, pipelines)


class _Names:
    """The names of instances, with their scenes and plans."""

    def __init__(self) -> None:
        self._scenes: dict[str, str] = dict.fromkeys(scene_names(), "")
        self._plans: set[tuple[str, str]] = set()

    def take(self, scene: Scene, plan: str) -> bool:
        """Take a name; return whether it is new. Several plans of one instance are no mistake.

        Raises InstanceError.
        """
        text, before = scene_text(scene), self._scenes.get(scene.name)
        if before not in (None, text) or (scene.name, plan) in self._plans:
            raise InstanceError(
                "another scene or plan has this name; rename the instance, or name the plans apart (name = ..)."
            )
        self._scenes[scene.name] = text
        self._plans.add((scene.name, plan))
        return before is None


class _Starts:
    """The starts of all instances of an entry, to find a plan that is of another instance."""

    def __init__(self) -> None:
        self._starts: dict[str, np.ndarray] = {}

    def add(self, one: _Made) -> None:
        self._starts[one.instance.name] = np.array(one.scene.task.start, dtype=float)

    def check(self, one: _Made) -> None:
        """Raise InstanceError if the plan starts where another instance starts, and not its own."""
        if one.plan is None or not one.plan.has_states:
            return
        nominal = np.array([item.nominal for item in one.scene.coordinates])
        here = one.plan.start[: one.scene.nq]

        def starts(start: np.ndarray) -> bool:
            return bool((np.abs(here - start[: len(here)]) <= _SAME_START * nominal).all())

        if starts(self._starts[one.instance.name]):
            return
        other = next((name for name, start in self._starts.items() if starts(start)), None)
        if other is not None:
            raise InstanceError(
                f"its plan starts where instance {other} starts, and not where this instance does; check plans and instances."
            )
