"""A run of a campaign: a scene by a pipeline, as plain data; and how the child of a task may end. What a worker does with a run: validate.tasks.path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from formulations.method import Pipeline
from formulations.pipelines import pipeline_from_json, pipeline_to_json
from validate.tasks.leg import PlannedLeg
from validate.tasks.variant import Variant


@dataclass(frozen=True, kw_only=True)
class RunTask:
    """A scene by a pipeline.

    scene: a name or an absolute path of a scene file; variant: what a campaign file changes of it; plugin: a dotted name (validate.tasks.plugins); legs:
    its path.
    """

    key: str
    scene: str
    scene_name: str
    pipeline: Pipeline
    plugin: str
    time_limit: float
    variant: Variant | None = None
    legs: tuple[PlannedLeg, ...] = ()

    @property
    def title(self) -> str:
        """What it is called."""
        part = self.pipeline.part
        return f"{self.scene_name} x {self.pipeline.name}" + (f" ({part[0]} of {part[1]})" if part else "")

    def to_json(self) -> dict[str, Any]:
        """Everything that a worker and a resumed campaign need."""
        return {
            "key": self.key,
            "scene": self.scene,
            "scene_name": self.scene_name,
            "pipeline": pipeline_to_json(self.pipeline),
            "plugin": self.plugin,
            "time_limit": self.time_limit,
            "legs": [asdict(leg) for leg in self.legs],
            **({} if self.variant is None else {"variant": self.variant.to_json()}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> RunTask:
        """The run that `to_json` wrote."""
        variant = Variant.from_json(data["variant"]) if "variant" in data else None
        legs = tuple(PlannedLeg(**leg) for leg in data["legs"])
        return cls(**{**data, "pipeline": pipeline_from_json(data["pipeline"]), "variant": variant, "legs": legs})


@dataclass(frozen=True, kw_only=True)
class ChildExit:
    """How a child ended that left no record. outcome: `crashed` or `time_limit`; message: one sentence; wall, cpu [s]; log: its end."""

    outcome: str
    message: str
    wall: float
    cpu: float
    log: str
