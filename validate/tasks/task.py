"""Tasks of a campaign as plain data with keys: a run, which is a scene by a pipeline, or a check.

And how the child of one may end.

    task = task_from_json(task_to_json(task))          # what a child is given

What a worker does with a run: validate.tasks.path; with a check: validate.tasks.check.

A campaign file may ask for a scene with some of its numbers changed; it has a name of its own, and
is a scene like any other: its text, numbers included, is part of the key of its tasks.

    varied(load_scene("three_cart"), Variant(name="three_cart_k_300", parameters={"k": 300.0}, goal={"q1": 2.6, "v1": None}))
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

from pydantic import TypeAdapter

from formulations.method import Pipeline
from models.errors import SceneError
from models.scene import Limit, Scene
from reports.records.check_record import CheckRecord
from reports.records.record import RunRecord

# The scene of a foreign plan is the physics, or the plan's own equations; empty: of no such plan.
JudgedBy: TypeAlias = Literal["", "scene", "model"]
# Judges the replay by closed forms, which are those of the unchanged scene.
_BY_ANSWERS = "answer_error"


@dataclass(frozen=True, kw_only=True)
class Variant:
    """What is changed: parameters by name.

    Start and goal by coordinate or velocity (None: that component of the end is free); limits:
    (value, reason) by metric.
    """

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    steps: int | None = None
    step: float | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    goal: Mapping[str, float | None] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneReference:
    """A scene of the campaign, what load_scene takes to find it again in a child, and what a campaign file changed of it (done in `scene`).

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
    """(2 nq,) names of the components of a state: positions, then velocities."""
    return (
        *(item.name for item in scene.coordinates),
        *(item.velocity_name for item in scene.coordinates),
    )


def varied(scene: Scene, variant: Variant) -> Scene:
    """The changed scene.

    Closed forms of the unchanged one, and the limit on them, are left out where motion changes.
    Raises SceneError.
    """
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
    """Each change but those of limits, as `k = 300 N/m`."""
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
    """The stages `first` (from 0) to before `end` of a pipeline. key: of the leg at this place of its path; alone: of the same leg at the beginning of one."""

    first: int
    end: int
    key: str
    alone: str


@dataclass(frozen=True, kw_only=True)
class RunTask:
    """A scene by a pipeline.

    scene: a name or an absolute path of a scene file; variant: what a campaign file changes of it;
        plugin: a dotted name (validate.tasks.plugins); legs:
    its path; uses: keys of legs of other runs that it reads if they are stored; worlds: indices
        of stages whose plans are tried in perturbed worlds (only for a stored run).
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
        """What it is called."""
        return f"{self.scene_name} x {self.pipeline.name}"

    @property
    def published(self) -> str:
        """Its scene, where that is one of the catalog as it stands there.

        Empty for a file of the user's, whatever it calls itself.
        """
        return self.scene_name if self.scene == self.scene_name else ""


@dataclass(frozen=True, kw_only=True)
class CheckTask:
    """A task that is no run: a function is asked a question, and what it finds is as expected or not.

    function: `module:name`, called in the child with the arguments (JSON data); content: text that
        decides the result beside arguments and
    sources, such as that of a scene (models.scene.text); sources: the parts of our sources that
        matter, as beginnings of
    paths (nothing: all of them); methods: names of the methods it runs; scene: the name of the one
        it is about; quick: whether `--quick` runs it;
    words: further names for `-k`; group: what it and its like are called where only their number is
        said; key and time_limit [s]: filled in by the campaign.
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
        """What it is called."""
        return f"{self.kind}: {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """What `-k` looks at."""
        return (self.kind, self.name, *self.words, *([self.scene] if self.scene else []))


Task: TypeAlias = RunTask | CheckTask
TaskRecord: TypeAlias = RunRecord | CheckRecord
_TASK: TypeAdapter[Task] = TypeAdapter(Task)


def path_of(task: Task) -> tuple[PlannedLeg, ...]:
    """Return the legs of a run; a check has none."""
    return task.legs if isinstance(task, RunTask) else ()


def task_to_json(task: Task) -> dict[str, Any]:
    """Everything that a child and a resumed campaign need."""
    return _TASK.dump_python(task, mode="json")


def task_from_json(data: Mapping[str, Any]) -> Task:
    """The task that `task_to_json` wrote. Raises pydantic's ValidationError."""
    return _TASK.validate_python(data)


@dataclass(frozen=True, kw_only=True)
class ChildExit:
    """How a task ended, such as a child that left no record. outcome: that of its record.

    message: one sentence; wall, cpu [s]; log: its end.
    """

    outcome: str
    message: str
    wall: float
    cpu: float
    log: str
