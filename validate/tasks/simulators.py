"""What other simulators say of a campaign's plans: of each scene the cheapest that holds, kept in the campaign's folder for its report.

ask_simulators(Path("runs/all"), load(Path("runs/all")), ("mujoco",), tell=print)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from models.catalog import load_scene
from models.errors import MachineError, TouchstoneError
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import read_netcdf
from reports.records.engines_record import SIMULATORS, EngineRecord, SimulatorsRecord
from reports.records.load import Stored
from reports.records.record import RunRecord, stage_files
from validate.execution.isolated import Limits
from validate.execution.process import usable_cores
from validate.judge.elsewhere import elsewhere
from validate.judge.judgement import judge_trajectory
from validate.judge.simulator import describe_engine
from validate.store.disk import write_durably
from validate.store.store import Store
from validate.store.stored import CampaignError
from validate.tasks.task import RunTask, task_from_json, varied


def stored_plan(
    folder: Path, record: RunRecord, scene: str | None = None
) -> tuple[Scene, Trajectory]:
    """The scene of a stored run, with what its campaign changed of it, or the one that is named, and its last plan. Raises CampaignError, SceneError, TrajectoryError."""
    last = record.last
    if last is None or not last.has_plan:
        raise CampaignError(f"{record.title}: this run left no plan, so there is nothing to try.")
    try:
        task = task_from_json(Store(folder).request(record.key))
    except ValueError:  # damaged: what the record says of the scene is its name
        task = None
    asked = task if scene is None and isinstance(task, RunTask) else None
    subject = load_scene(scene or (record.scene.name if asked is None else asked.scene))
    if asked is not None and asked.variant is not None:
        subject = varied(subject, asked.variant)
    return subject, read_netcdf(
        folder / "runs" / record.key / stage_files(last.index, len(record.stages))["trajectory"],
        subject,
    )


def ask_simulators(
    folder: Path, stored: Stored, engines: Sequence[str], tell: Callable[[str], None]
) -> SimulatorsRecord:
    """Ask engines of the cheapest plan that holds of each scene.

    Each plan's rows are on the disk as soon as they are there.

    tell: gets a line for each answer. What was asked of other runs is forgotten; what cannot be
        asked is a line. Raises UnknownNameError, MachineError.
    """
    named = {
        name: f"{describe_engine(name).title}; {describe_engine(name).law}" for name in engines
    }
    scenes = dict.fromkeys(run.scene.name for run in stored.runs)
    best = [priced[0][0] for scene in scenes if (priced := stored.cheapest(scene))]
    earlier = stored.simulators or SimulatorsRecord()
    if not best:
        tell("no plan of this campaign holds at a known cost, so no simulator was asked")
    kept = {run.key: rows for run in best if (rows := earlier.plans.get(run.key))}
    found = SimulatorsRecord(engines={**earlier.engines, **named}, plans=kept)
    for run in best:
        try:
            scene, plan = stored_plan(folder, run)
            judgement = judge_trajectory(scene, build_fmu(scene), plan, limits=Limits())
            rows = elsewhere(
                judgement,
                engines,
                jobs=usable_cores(),
                tell=lambda text, run=run: tell(f"{run.title}: {text}"),
            )
        except MachineError:
            raise
        except TouchstoneError as error:
            tell(f"{run.title}: no simulator was asked: {error}")
            continue
        found = found.with_rows(
            run.key, tuple(EngineRecord.model_validate(row.as_json()) for row in rows)
        )
        write_durably(folder / SIMULATORS, found.model_dump_json(indent=1))
    return found
