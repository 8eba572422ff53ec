"""Tasks of a campaign as plain data with keys: a run, scene by pipeline, or a check.

    task = task_from_json(task_to_json(task))          # for a child
    varied(load_scene("three_cart"), Variant(name="three_cart_k_300", parameters={"k": 300.0}))

A campaign file may vary a scene's numbers; the variant is a scene with its own name and key. Work
of runs: validate.tasks.path; of checks: validate.tasks.check.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

from pydantic import TypeAdapter

from formulations.method import Pipeline
from models.errors import SceneError
from models.results.check import CheckRecord
from models.results.run import RunRecord
from models.scene import Limit, Scene

# The scene of a foreign plan is the physics, or the plan's own equations; empty: of no such plan.
JudgedBy: TypeAlias = Literal["", "scene", "model"]
# Metric by closed forms, which hold for the unchanged scene only.
_BY_ANSWERS = "answer_error"


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Changes of a scene by name; a goal of None is free; limits: (value, reason) by metric."""

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    steps: int | None = None
    step: float | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    goal: Mapping[str, float | None] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneReference:
    """A scene, the argument of load_scene for children, and its variation, applied in `scene`.

    instance, judged_by: of a campaign of foreign plans, the instance and the role of the scene;
    pipelines: those of this scene alone, None for those of the campaign.
    """

    where: str
    scene: Scene
    variant: Variant | None = None
    instance: str = ""
    judged_by: JudgedBy = ""
    pipelines: tuple[Pipeline, ...] | None = None


def state_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of a state's components (2 nq,): positions, then velocities."""
    return (
        *(item.name for item in scene.coordinates),
        *(item.velocity_name for item in scene.coordinates),
    )


def varied(scene: Scene, variant: Variant) -> Scene:
    """Return the varied scene, without closed forms if the motion changes. Raises SceneError."""
    limits = {limit.metric: limit for limit in scene.limits}
    moves = (
        variant.parameters
        or variant.start
        or variant.goal
        or variant.steps is not None
        or variant.step is not None
    )
    if moves:
        limits.pop(_BY_ANSWERS, None)
    task = replace(
        scene.task,
        start=_state(scene, "start", scene.task.start, variant.start),
        goal=_state(scene, "goal", scene.task.goal, variant.goal),
        steps=scene.task.steps if variant.steps is None else variant.steps,
        step=scene.task.step if variant.step is None else variant.step,
    )
    limits |= {
        metric: Limit(metric=metric, value=value, reason=reason)
        for metric, (value, reason) in variant.limits.items()
    }
    changes = ", ".join(in_words(scene, variant))
    return replace(
        scene.with_parameters(**variant.parameters),
        name=variant.name,
        title=f"{scene.title}; {changes}" if changes else scene.title,
        task=task,
        limits=tuple(limits.values()),
        answers=() if moves else scene.answers,
    )


def in_words(scene: Scene, variant: Variant) -> list[str]:
    """Return each change except limits, as `k = 300 N/m`."""
    units = {item.name: item.unit for item in scene.parameters}
    words = [
        f"{name} = {value:g} {units.get(name, '')}".rstrip()
        for name, value in variant.parameters.items()
    ]
    words += [f"start {name} = {value:g}" for name, value in variant.start.items()]
    words += [
        f"goal {name} {'free' if value is None else f'= {value:g}'}"
        for name, value in variant.goal.items()
    ]
    words += [] if variant.steps is None else [f"{variant.steps} steps"]
    return words + ([] if variant.step is None else [f"h = {variant.step:g} s"])


def _state(
    scene: Scene, what: str, values: Iterable[float | None], changes: Mapping[str, float | None]
) -> tuple[Any, ...]:
    names = state_names(scene)
    for name in changes:
        if name not in names:
            raise SceneError(
                f"scene {scene.name}: {what} has no component {name!r}; it has {', '.join(names)}."
            )
    return tuple(changes.get(name, value) for name, value in zip(names, values, strict=True))


@dataclass(frozen=True)
class PlannedLeg:
    """Stages `first` (from 0) to before `end`; key: at this place; alone: at a path's beginning."""

    first: int
    end: int
    key: str
    alone: str


@dataclass(frozen=True, kw_only=True)
class RunTask:
    """A scene by a pipeline.

    - scene: name, or absolute path of a file.
    - plugin: dotted name.
    - legs: its path.
    - uses: keys of other runs' legs that it may read.
    - worlds: stages to survey (of a stored run).
    """

    key: str
    scene: str
    scene_name: str
    pipeline: Pipeline
    plugin: str
    time_limit: float
    variant: Variant | None = None
    legs: tuple[PlannedLeg, ...] = ()
    uses: tuple[str, ...] = ()
    worlds: tuple[int, ...] = ()
    instance: str = ""
    judged_by: JudgedBy = ""

    @property
    def title(self) -> str:
        """Return the name of the task."""
        return f"{self.scene_name} x {self.pipeline.name}"

    @property
    def published(self) -> str:
        """Return the scene's name if it is of the catalog, else ""."""
        return self.scene_name if self.scene == self.scene_name else ""


@dataclass(frozen=True, kw_only=True)
class CheckTask:
    """A function called in a child, with an expected result.

    - function: `module:name`.
    - arguments: JSON data.
    - content: text that decides the result, such as a scene's.
    - sources: path prefixes of relevant sources, () for all.
    - methods: used ones.
    - quick: run by `--quick`.
    - words: further names for `-k`.
    - group: collective name.
    - key, time_limit [s]: set by the campaign.
    """

    kind: str
    name: str
    expected: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    content: str = ""
    sources: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    scene: str | None = None
    quick: bool = True
    words: tuple[str, ...] = ()
    group: str = ""
    key: str = ""
    time_limit: float = 0.0

    @property
    def title(self) -> str:
        """Return the name of the task."""
        return f"{self.kind}: {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names for `-k`."""
        return (self.kind, self.name, *self.words, *([self.scene] if self.scene else []))


Task: TypeAlias = RunTask | CheckTask
TaskRecord: TypeAlias = RunRecord | CheckRecord
_TASK: TypeAdapter[Task] = TypeAdapter(Task)


def path_of(task: Task) -> tuple[PlannedLeg, ...]:
    """Return the legs of a run; a check has none."""
    return task.legs if isinstance(task, RunTask) else ()


def task_to_json(task: Task) -> dict[str, Any]:
    """Return a task as JSON data, for children and resumed campaigns."""
    return _TASK.dump_python(task, mode="json")


def task_from_json(data: Mapping[str, Any]) -> Task:
    """Return the task of `task_to_json`. Raises pydantic's ValidationError."""
    return _TASK.validate_python(data)


@dataclass(frozen=True, kw_only=True)
class ChildExit:
    """Ending of a task: outcome for its record, a sentence, times [s] and the end of its log."""

    outcome: str
    message: str
    wall: float
    cpu: float
    log: str
