"""A scene with some of its numbers changed, as a campaign file asks for it; it has a name of its own.

    varied(load_scene("three_cart"), Variant(name="three_cart_k_300", parameters={"k": 300.0}, goal={"q1": 2.6, "v1": None}))

The changed scene is a scene like any other: its text, numbers included, is part of the key of its tasks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from models.errors import SceneError
from models.scene import Limit, Scene

# Judges the replay by closed forms, which are those of the unchanged scene.
_BY_ANSWERS = "answer_error"


@dataclass(frozen=True, kw_only=True)
class Variant:
    """What is changed: parameters by name; start and goal by coordinate or velocity (None: that component of the end is free); limits: (value, reason) by metric."""

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    steps: int | None = None
    step: float | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    goal: Mapping[str, float | None] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneReference:
    """A scene of the campaign, what load_scene takes to find it again in a child, and what a campaign file changed of it (done in `scene`)."""

    where: str
    scene: Scene
    variant: Variant | None = None


def state_names(scene: Scene) -> tuple[str, ...]:
    """(2 nq,) names of the components of a state: positions, then velocities."""
    return (*(item.name for item in scene.coordinates), *(item.velocity_name for item in scene.coordinates))


def varied(scene: Scene, variant: Variant) -> Scene:
    """The changed scene. Closed forms of the unchanged one, and the limit on them, are left out where motion changes. Raises SceneError."""
    limits = {limit.metric: limit for limit in scene.limits}
    moves = variant.parameters or variant.start or variant.goal or variant.steps is not None or variant.step is not None
    if moves:
        limits.pop(_BY_ANSWERS, None)
    task = replace(
        scene.task,
        start=_state(scene, "start", scene.task.start, variant.start),
        goal=_state(scene, "goal", scene.task.goal, variant.goal),
        steps=scene.task.steps if variant.steps is None else variant.steps,
        step=scene.task.step if variant.step is None else variant.step,
    )
    limits |= {metric: Limit(metric=metric, value=value, reason=reason) for metric, (value, reason) in variant.limits.items()}
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
    words = [f"{name} = {value:g} {units.get(name, '')}".rstrip() for name, value in variant.parameters.items()]
    words += [f"start {name} = {value:g}" for name, value in variant.start.items()]
    words += [f"goal {name} {'free' if value is None else f'= {value:g}'}" for name, value in variant.goal.items()]
    words += [] if variant.steps is None else [f"{variant.steps} steps"]
    return words + ([] if variant.step is None else [f"h = {variant.step:g} s"])


def _state(scene: Scene, what: str, values: Iterable[float | None], changes: Mapping[str, float | None]) -> tuple[Any, ...]:
    names = state_names(scene)
    for name in changes:
        if name not in names:
            raise SceneError(f"scene {scene.name}: {what} has no component {name!r}; it has {', '.join(names)}.")
    return tuple(changes.get(name, value) for name, value in zip(names, values, strict=True))
