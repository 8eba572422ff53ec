"""Tasks of a campaign as plain data with keys: a run, which is a scene by a pipeline, or a check; and how the child of one may end.

    task = task_from_json(task_to_json(task))          # what a child is given

What a worker does with a run: validate.tasks.path; with a check: validate.tasks.check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pydantic import TypeAdapter

from formulations.method import Pipeline
from reports.records.check_record import CheckRecord
from reports.records.record import RunRecord
from validate.tasks.variant import Variant


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

    scene: a name or an absolute path of a scene file; variant: what a campaign file changes of it; plugin: a dotted name (validate.tasks.plugins); legs:
    its path; robust: whether plans that hold are tried in perturbed worlds.
    """

    key: str
    scene: str
    scene_name: str
    pipeline: Pipeline
    plugin: str
    time_limit: float
    variant: Variant | None = None
    legs: tuple[PlannedLeg, ...] = ()
    robust: bool = True

    @property
    def title(self) -> str:
        """What it is called."""
        part = self.pipeline.part
        return f"{self.scene_name} x {self.pipeline.name}" + (f" ({part[0]} of {part[1]})" if part else "")


@dataclass(frozen=True, kw_only=True)
class CheckTask:
    """A task that is no run: a function is asked a question, and what it finds is as expected or not.

    function: `module:name`, called in the child with the arguments (JSON data); content: text that decides the result beside arguments and
    sources, such as that of a scene (models.scene.text); sources: the parts of our sources that matter, as beginnings of
    paths (nothing: all of them); methods: names of the methods it runs; scene: the name of the one it is about; quick: whether `--quick` runs it;
    words: further names for `-k`; group: what it and its like are called where only their number is said; key and time_limit [s]: filled in by the campaign.
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


def task_to_json(task: Task) -> dict[str, Any]:
    """Everything that a child and a resumed campaign need."""
    return _TASK.dump_python(task, mode="json")


def task_from_json(data: Mapping[str, Any]) -> Task:
    """The task that `task_to_json` wrote. Raises pydantic's ValidationError."""
    return _TASK.validate_python(data)


@dataclass(frozen=True, kw_only=True)
class ChildExit:
    """How a child ended that left no record. outcome: `crashed` or `time_limit`; message: one sentence; wall, cpu [s]; log: its end."""

    outcome: str
    message: str
    wall: float
    cpu: float
    log: str
