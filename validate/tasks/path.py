"""Run of a worker: the legs of its path, each read from the store, or solved, judged and stored.

    record = run_path(task, provenance, folder, profile)        # in a child: validate.tasks.child
    record = survey_run(task, folder, profile)                  # later, if its plan is the cheapest
    record = unfinished_run(task, loaded, provenance, child, folder)    # if that is missing

Judged legs are kept in the run's folder, even if the run fails. Beside the record are
`trajectory.nc` and `replay.nc` of the last stage, `trajectory_<n>.nc` and `replay_<n>.nc` of stage
n (from 1), `tracked.nc` and `tracked_<n>.nc` of tracked replays, and gains with the trajectory.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from formulations.solution import Outcome
from models.catalog import load_scene
from models.errors import MachineError, TouchstoneError
from models.results.robustness import Survey
from models.results.run import LegRecord, RunRecord, stage_files
from models.results.stored import from_json, to_json
from models.results.verdict import HOLD
from models.trajectory_netcdf import read_netcdf
from validate.processes.disk import raise_if_disk_ended, write_durably
from validate.store.provenance import content_key, survey_sources
from validate.store.store import Store, log_in, progress
from validate.tasks import leg as legs
from validate.tasks.leg import Planned, planned_stages
from validate.tasks.plugins import load_plugin, plugin_source
from validate.tasks.profile import Profile, waits
from validate.tasks.records import run_record, solution_of, stages_of, unfinished_stage
from validate.tasks.scene_record import scene_record
from validate.tasks.stage import Judge, OpenLeg, SolvedStage, first_line, in_words, prepare
from validate.tasks.task import varied

if TYPE_CHECKING:
    from formulations.method import Leg
    from formulations.solution import Solution
    from models.results.run import ProvenanceRecord, StageRecord
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.tasks.task import ChildExit, PlannedLeg, RunTask

# Share of a run's time limit reserved for certificates and replays.
_JUDGING_SHARE = 0.25
# Largest such time [s]; the paper's scene needs 2 s, a certificate of two fingers 3 CPU s.
_JUDGING_MOST = 60.0

# A stage without an answer, outcome, and reason.
Unfinished: TypeAlias = "tuple[Planned, Outcome, str]"


@dataclass(frozen=True, kw_only=True)
class LoadedRun:
    """The scene and the stages of a run."""

    scene: Scene
    plan: tuple[Planned, ...]


def load_run(task: RunTask, profile: Profile) -> LoadedRun:
    """Load the run of a task. Raises UnknownNameError, SceneError, OptionError."""
    plugin = load_plugin(task.plugin)
    profile.lap("imports")
    scene = load_scene(task.scene)
    if task.variant is not None:
        scene = varied(scene, task.variant)
    profile.lap("scene")
    plan = planned_stages(task.pipeline, plugin.methods_of(task.pipeline))
    profile.lap("imports")
    return LoadedRun(scene=scene, plan=plan)


def run_path(
    task: RunTask, provenance: ProvenanceRecord, folder: Path, profile: Profile
) -> RunRecord:
    """Return the record of a run; its time limit counts from the profile's start.

    Raises MachineError if this machine cannot go on; other errors are recorded.
    """
    loaded = load_run(task, profile)
    scene, plan = loaded.scene, loaded.plan
    rest = refused(scene, plan)
    profile.lap("opening")
    if not rest:
        deadline = (
            profile.began + task.time_limit - min(_JUDGING_MOST, _JUDGING_SHARE * task.time_limit)
        )
        rest = _Path(task, loaded, folder, profile, deadline).go()
    stages = _stages_in(folder, task, legs.legs_in(folder, task.legs), len(plan))
    stages += [
        unfinished_stage(task.published, task.pipeline.name, planned, outcome, message)
        for planned, outcome, message in rest
    ]
    cause = rest[0][2] if rest else None  # later stages only refer to it
    drawn = scene_record(scene)
    profile.lap("record")
    wall, cpu = profile.total, time.process_time()
    return run_record(
        task,
        drawn,
        stages,
        provenance,
        wall=wall,
        cpu=cpu,
        log=log_in(folder),
        message=cause,
        profile=profile.seconds,
    )


def unfinished_run(
    task: RunTask, loaded: LoadedRun, provenance: ProvenanceRecord, child: ChildExit, folder: Path
) -> RunRecord:
    """Return the record of a run whose child left none, with the legs in its folder.

    After a timeout it has the outcome of its last stage, else that of the child.
    """
    scene, plan = loaded.scene, loaded.plan
    found, is_late = legs.legs_in(folder, task.legs), child.outcome == "time_limit"
    why = f"The certificate is missing{' because time ran out: the run' if is_late else ':'} {child.message}"
    stages = [
        replace(stage, message=f"{stage.message} {why}".strip())
        if stage.certificate_missing
        else stage
        for stage in _stages_in(folder, task, found, len(plan))
    ]
    rest = plan[len(stages) :]
    in_certificate = not rest and stages[-1].certificate_missing
    profile = dict(found[-1].profile) if in_certificate else {}
    known = sum(profile.values())
    wall = max(child.wall, known)  # clocks of parent and child
    if in_certificate:
        profile["certificate"] = profile.get("certificate", 0.0) + wall - known
    stages += [
        unfinished_stage(
            task.published,
            task.pipeline.name,
            planned,
            Outcome[child.outcome.upper()],
            f"{child.message}{waits(child.wall, child.cpu) if is_late else ''}",
        )
        for planned in rest
    ]
    return run_record(
        task,
        scene_record(scene),
        stages,
        provenance,
        wall=wall,
        cpu=child.cpu,
        log=child.log,
        outcome=None if is_late else child.outcome,
        message=why if in_certificate else child.message,
        profile=profile,
    )


def _stages_in(
    folder: Path, task: RunTask, found: Sequence[LegRecord], stages: int
) -> list[StageRecord]:
    number = 0
    for place, leg in enumerate(found, 1):
        for own in range(1, len(leg.stages) + 1):
            names = stage_files(number, stages)
            for what, name in legs.leg_files(own).items():
                if (source := legs.place(folder, place) / name).exists():
                    legs.link_file(source, folder / names[what])
            number += 1
    return stages_of(found, task.published, task.pipeline.name)


def survey_run(task: RunTask, folder: Path, profile: Profile) -> RunRecord:
    """Survey the plans of the stages `task.worlds` of a stored run; return the amended record.

    Raises MachineError, and TouchstoneError if the run was deleted.
    """
    scene, store = load_run(task, profile).scene, Store(folder.parents[1])
    run = store.read(task.key)
    if not isinstance(run, RunRecord):
        raise TouchstoneError(f"{task.title}: its stored run was deleted; run the campaign again.")
    stages = tuple(
        _surveyed(stage, scene, task, folder, len(run.stages))
        if stage.index in task.worlds
        else stage
        for stage in run.stages
    )
    profile.lap("survey")
    return amended(run, stages, profile.total, time.process_time(), profile.seconds)


def amended(
    run: RunRecord,
    stages: tuple[StageRecord, ...],
    wall: float,
    cpu: float,
    profile: Mapping[str, float],
) -> RunRecord:
    """Return a run's record with new stages; wall, cpu, profile [s]: time to add."""
    seconds = Counter(run.profile)
    seconds.update(profile)
    return replace(
        run,
        stages=stages,
        wall_seconds=run.wall_seconds + wall,
        cpu_seconds=run.cpu_seconds + cpu,
        profile=dict(seconds),
    )


def unfinished_survey(task: RunTask, run: RunRecord, child: ChildExit) -> RunRecord:
    """Return the record of a run with failed surveys; without a digest, so they are repeated."""
    message = f"not tried in perturbed worlds: {child.message}"
    stages = tuple(
        replace(stage, survey=Survey(message=message)) if stage.index in task.worlds else stage
        for stage in run.stages
    )
    return amended(run, stages, child.wall, child.cpu, {})


def _surveyed(
    stage: StageRecord, scene: Scene, task: RunTask, folder: Path, stages: int
) -> StageRecord:
    """Return the stage with the survey of its plan, stored or computed."""
    store = Store(folder.parents[1])
    plan = read_netcdf(
        store.runs / task.key / stage_files(stage.index, stages)["trajectory"], scene
    )
    limits = {metric.name: metric.limit for metric in stage.metrics if metric.limit is not None}
    followed = stage.verdict != HOLD[0]
    numbers = hashlib.sha256(
        b"".join(
            array.tobytes()
            for array in (plan.t, plan.q, plan.v, plan.u, plan.u_end)
            if array is not None
        )
    )
    request = [survey_sources(), numbers.hexdigest(), plan.hold.value, limits, followed]
    stored = store.surveys / f"{content_key(scene, request, (), plugin_source(task.plugin))}.json"
    with contextlib.suppress(OSError, ValueError):  # not stored, or damaged
        return replace(stage, survey=from_json(Survey, stored.read_bytes()))
    progress(folder, f"stage {stage.index + 1} ({stage.method}) in perturbed worlds")
    try:
        answer = load_plugin(task.plugin).survey(scene, plan, limits, followed)
        survey = replace(answer, sources=survey_sources())
        stored.parent.mkdir(exist_ok=True)
        write_durably(stored, to_json(survey))
    except MachineError:
        raise
    except Exception as error:  # noqa: BLE001 - a failed survey must not lose the plan; the log has the traceback
        raise_if_disk_ended(folder, error)
        if not isinstance(error, TouchstoneError):
            traceback.print_exc()
        survey = Survey(message=in_words(error), sources=survey_sources())
    return replace(stage, survey=survey)


def refused(scene: Scene, plan: Sequence[Planned]) -> list[Unfinished]:
    """Return all stages if a method does not apply to the scene, else none."""
    for planned in plan:
        reason = planned.method.accepts(scene)
        if reason is not None:
            return [(other, Outcome.REFUSED, f"{planned.name}: {reason}") for other in plan]
    return []


class _Path:
    """The legs of a run; deadline: end of solving by time.monotonic(), without judging."""

    def __init__(
        self, task: RunTask, loaded: LoadedRun, folder: Path, profile: Profile, deadline: float
    ) -> None:
        self._task, self._scene, self._plan, self._folder, self._profile = (
            task,
            loaded.scene,
            loaded.plan,
            folder,
            profile,
        )
        self._plugin, self._deadline = load_plugin(task.plugin), deadline
        self._stored = Store(folder.parents[1]).legs  # unfinished runs are in DIR/runs
        self._judge = Judge(self._plugin, self._scene, profile)
        self._start: Trajectory | None = None
        self._is_prepared = False
        # True after reading another run's leg: the time left is then not reproducible.
        self._took = False
        self._source = plugin_source(task.plugin)
        self._used: list[legs.StoredStage] = []  # stored stages used by methods

    def _stored_stages(self, path: Sequence[Leg]) -> Sequence[Solution] | None:
        """Return the stored stages of a cold path's last leg, None if not stored."""
        methods = {leg.method: self._plugin.load_method(leg.method) for leg in path}
        results = legs.stored_stages(
            self._stored,
            path,
            self._scene,
            methods,
            lambda stages: legs.leg_key(self._scene, stages, self._source),
        )
        self._used += results
        return [solution_of(stage.record, stage.plan) for stage in results] or None

    def go(self) -> list[Unfinished]:
        for number, leg in enumerate(self._task.legs, 1):
            rest = self._leg(number, leg)
            if rest:
                return rest
        return []

    def _leg(self, number: int, leg: PlannedLeg) -> list[Unfinished]:
        """Take a leg from the store or run it; return the stages that do not run any more."""
        limit = self._task.time_limit
        taken = self._take(number, leg, leg.key, limit)
        solved: list[SolvedStage] = []
        rest: list[Unfinished] = []
        key = leg.key
        if taken is None:
            if not self._is_prepared:
                prepare(
                    self._plugin, self._scene, self._plan[leg.first :], self._folder, self._profile
                )
                self._is_prepared = True
            first = self._plan[leg.first]
            if time.monotonic() >= self._deadline:
                return self._out_of_time(first)
            try:
                with closing(OpenLeg(self._scene, first)) as opened:
                    opened.use_stored(self._stored_stages)
                    if leg.first and (self._start is None or opened.leaves(self._start)):
                        key = leg.alone
                        taken = self._take(number, leg, key)
                        if taken is not None:
                            folder = legs.place(self._folder, number)
                            legs.store_as(folder, taken, leg.key, self._stored)
                    if taken is None:
                        solved, rest = self._solve(leg, opened)
            except MachineError:
                raise
            except Exception as error:  # noqa: BLE001 - any failure is recorded, with its traceback in the log
                return self._failed(first, error)
        if taken is None:
            ended = time.monotonic()
            if solved:
                self._finish(number, leg, key, solved, is_over=ended >= self._deadline)
            self._deadline += time.monotonic() - ended
        elif taken.limit is not None:
            return self._out_of_time(self._plan[leg.first + len(taken.stages)])
        return rest

    def _take(
        self, number: int, leg: PlannedLeg, key: str, limit: float | None = None
    ) -> LegRecord | None:
        found = legs.take(
            self._stored,
            key,
            limit,
            leg.end - leg.first,
            legs.place(self._folder, number),
            self._scene,
        )
        self._profile.lap("shared")
        if found is None:
            return None
        taken, plan = found
        self._took, self._start = True, plan or self._start
        return taken

    def _solve(
        self, leg: PlannedLeg, opened: OpenLeg
    ) -> tuple[list[SolvedStage], list[Unfinished]]:
        """Return the solved stages of a leg, and the remaining ones of the path."""
        solved: list[SolvedStage] = []
        for planned in self._plan[leg.first : leg.end]:
            seconds_left = self._deadline - time.monotonic()
            if seconds_left <= 0:
                return solved, self._out_of_time(planned)
            progress(self._folder, f"stage {planned.index + 1} ({planned.title})")
            try:
                item = opened.run(planned, self._start, seconds_left)
            except MachineError:
                raise
            except Exception as error:  # noqa: BLE001 - as above
                return solved, self._failed(planned, error)
            spent, elsewhere = item.solution.seconds, item.elsewhere
            parts = {
                name: getattr(spent, name) - getattr(elsewhere, name)
                for name in ("build", "translate", "evaluate", "linear_algebra")
            }
            self._profile.split(parts, rest="solve_rest")
            solved.append(item)
            self._start = item.solution.trajectory or self._start
        return solved, []

    def _finish(
        self, number: int, leg: PlannedLeg, key: str, solved: list[SolvedStage], *, is_over: bool
    ) -> None:
        """Judge, certify and, if reproducible, store a leg; is_over: no time is left."""
        folder = legs.place(self._folder, number)
        folder.mkdir()
        records: list[StageRecord] = []
        progress(self._folder, "the replay")
        for item in solved:
            before = records[-1].seconds.total if records else 0.0
            plan = item.solution.trajectory
            same = next((stage for stage in self._used if stage.plan is plan is not None), None)
            records.append(self._judge.record(item, folder, len(records), before, same))

        def keep(limit: float | None = None) -> LegRecord:
            pipeline, spent = self._task.pipeline.name, dict(self._profile.seconds)
            return legs.write_leg(
                folder,
                LegRecord(
                    key=key,
                    pipeline=pipeline,
                    stages=tuple(records),
                    files={},
                    limit=limit,
                    profile=spent,
                ),
            )

        keep()
        for place, item in enumerate(solved):
            if records[place].certificate_missing:
                progress(
                    self._folder,
                    f"the certificate of stage {item.planned.index + 1} ({item.planned.title})",
                )
                records[place] = self._judge.certified(records[place], item)
                keep()
        if len(solved) == leg.end - leg.first and legs.is_deterministic(records):
            legs.store(folder, keep(), self._stored)
            if key != leg.key:
                legs.store_as(folder, keep(), leg.key, self._stored)
        elif is_over and not self._took and legs.ended_by_timeout(records):
            legs.store(folder, keep(self._task.time_limit), self._stored)
        self._profile.lap("shared")

    def _out_of_time(self, first: Planned) -> list[Unfinished]:
        # User and system time, of this process and of its replays.
        share = waits(self._profile.total, sum(os.times()[:4]))
        message = f"the run's time was used up before this stage.{share}"
        return [(planned, Outcome.TIME_LIMIT, message) for planned in self._plan[first.index :]]

    def _failed(self, planned: Planned, error: Exception) -> list[Unfinished]:
        raise_if_disk_ended(self._folder, error)
        traceback.print_exc()
        self._profile.lap("solve_rest")
        outcome = Outcome.FAILED if isinstance(error, TouchstoneError) else Outcome.CRASHED
        message = (
            str(error)
            if isinstance(error, TouchstoneError)
            else f"{type(error).__name__} in {planned.name}: {first_line(error)}"
        )
        later = f"not begun, because stage {planned.index + 1} ({planned.title}) gave no answer."
        return [
            (other, outcome, message if other is planned else later)
            for other in self._plan[planned.index :]
        ]
