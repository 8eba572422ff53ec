"""One cell: a scene by a pipeline. First everything is solved, then everything is replayed and scored, last come the certificates; so times are
clean, and a certificate that takes too long costs nothing else. Only what other cells begin with is replayed as soon as it is solved, and shared.

    record = run_cell(cell, provenance, folder)        # in a child process of its own: see validate.execution.worker

Each stage starts from the plan of the stage before it (or of the last one that had a plan). Beside the record the folder holds
`trajectory.nc` and `replay.nc` of the last stage, and `trajectory_<n>.nc` and `replay_<n>.nc` of every other stage n (from 1); where there was a tracked
replay too, also `tracked.nc` and `tracked_<n>.nc`, and the gains with the trajectory.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from formulations.method import Pipeline
from formulations.pipelines import pipeline_from_json, pipeline_to_json
from validate.store.store import LOG, progress
from validate.tasks.profile import Profile
from validate.tasks.shared_stages import Beginning
from validate.tasks.variant import Variant, varied

if TYPE_CHECKING:
    from reports.records.record import ProvenanceRecord, RunRecord

# Of a cell's time limit, what is kept for certificates, replaying and scoring: a quarter, but no more than 60 s. The paper's scene needs 2 s;
# the certificate of two fingers takes 3 CPU s.
_JUDGING_SHARE, _JUDGING_MOST = 0.25, 60.0


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What is to be run. scene: a name or an absolute path of a scene file; variant: what a campaign file changes of it; tools: a dotted
    name (validate.tasks.plugins); beginnings: those that other cells have too, the longest first; restarts: later stages that others begin with."""

    key: str
    scene: str
    scene_name: str
    pipeline: Pipeline
    tools: str
    time_limit: float
    variant: Variant | None = None
    beginnings: tuple[Beginning, ...] = ()
    restarts: tuple[Beginning, ...] = ()

    @property
    def title(self) -> str:
        part = self.pipeline.part
        return f"{self.scene_name} x {self.pipeline.name}" + (f" ({part[0]} of {part[1]})" if part else "")

    def to_json(self) -> dict[str, Any]:
        return {
            "key": self.key,
            "scene": self.scene,
            "scene_name": self.scene_name,
            "pipeline": pipeline_to_json(self.pipeline),
            "tools": self.tools,
            "time_limit": self.time_limit,
            "beginnings": [[item.stages, item.key] for item in self.beginnings],
            "restarts": [[item.stages, item.key, item.first] for item in self.restarts],
            **({} if self.variant is None else {"variant": self.variant.to_json()}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Cell:
        variant = Variant.from_json(data["variant"]) if "variant" in data else None
        shared = {name: tuple(Beginning(*item) for item in data[name]) for name in ("beginnings", "restarts")}
        return cls(**{**data, "pipeline": pipeline_from_json(data["pipeline"]), "variant": variant, **shared})


def run_cell(cell: Cell, provenance: ProvenanceRecord, folder: Path, began: float, profile: Profile | None = None) -> RunRecord:
    """Solve, judge and describe a cell. began: time.monotonic() at the start of the process, from which the time limit counts; profile: of
    the process until now.

    Raises MachineError where this machine cannot go on; whatever else goes wrong in a method or the judge is in the record.
    """
    from models.catalog import load_scene
    from validate.tasks.cell_stages import CellStages, refused
    from validate.tasks.plugins import load_tools
    from validate.tasks.records import planned_stages, run_record, unfinished_stage
    from validate.tasks.scene_record import scene_record

    profile = profile or Profile(began)
    tools = load_tools(cell.tools)
    profile.lap("imports")
    scene = load_scene(cell.scene)
    if cell.variant is not None:
        scene = varied(scene, cell.variant)
    profile.lap("scene")
    methods = {leg.method: tools.load_method(leg.method) for leg in cell.pipeline.legs}
    plan = planned_stages(cell.pipeline, methods)
    deadline = began + cell.time_limit - min(_JUDGING_MOST, _JUDGING_SHARE * cell.time_limit)
    profile.lap("imports")
    stages = CellStages(cell, tools, scene, plan, folder, profile)
    rest = refused(scene, plan)
    profile.lap("opening")
    if not rest:
        rest = stages.solve(deadline)
        progress(folder, "the replay")
        stages.judge()
    unfinished = [unfinished_stage(scene.name, cell.pipeline.name, planned, outcome, message) for planned, outcome, message in rest]
    drawn = scene_record(scene)
    cause = rest[0][2] if rest else None  # the stages after it only say that it came before them

    def told() -> RunRecord:
        log = folder / LOG
        profile.lap("record")
        text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        wall, cpu = profile.total, time.process_time()
        return run_record(
            cell, drawn, [*stages.records, *unfinished], provenance, wall=wall, cpu=cpu, log=text, message=cause, profile=profile.seconds
        )

    stages.certify(told)
    return told()
