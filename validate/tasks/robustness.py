"""The page of how much a plan can take, with some of the worlds it was tried in."""

from __future__ import annotations

import tempfile
from pathlib import Path

from models.scene import Scene
from models.trajectory import Trajectory
from reports.records.record import RunRecord
from reports.records.robustness_record import RobustnessRecord
from reports.render import render_robustness
from validate.judge.robustness import Robustness
from validate.store.provenance import gather
from validate.tasks.records import given_stage
from validate.tasks.scene_record import scene_record
from validate.tasks.shown import write_drawn


def robustness_page(found: Robustness, record: RobustnessRecord, scene: Scene, plan: Trajectory, name: str) -> str:
    """The text of the page. name: what the plan is called. Raises MachineError."""
    stage = given_stage(name, None, found.judgement.score, found.seconds)
    run = RunRecord(
        key="plan", scene=scene_record(scene), pipeline=name, pipeline_title="", stages=(stage,), outcome=stage.outcome, message="",
        verdict=found.verdict.value, must_hold=True, wall_seconds=0.0, cpu_seconds=found.seconds, provenance=gather(""),
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="touchstone-") as place:
        folder = Path(place)
        (folder / "worlds").mkdir()
        write_drawn(folder / "plan.nc", plan, scene)
        for number, trial in found.motions:
            steps = len(trial.states) - 1
            if steps > 0:
                positions, velocities = trial.states[:, : scene.nq], trial.states[:, scene.nq :]
                motion = Trajectory(
                    t=plan.t[: steps + 1], q=positions, v=velocities, u=plan.u[:steps], lam=plan.lam[:steps], missing=frozenset({"lam", "friction"})
                )  # fmt: skip
                write_drawn(folder / "worlds" / f"{number}.nc", motion, scene)
        return render_robustness(record, name, run, folder)
