"""Stage of a run: solved in its leg's session, replayed and scored, certified.

prepare(plugin, scene, plan, folder, profile)  # once, outside the stages' times
with closing(OpenLeg(scene, planned)) as leg:
    solved = leg.run(planned, start, time_limit)
record = judge.record(solved, folder, index, before)
record = judge.certified(record, solved)
"""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from formulations.method import Kind, Leg, StoredStages
from formulations.solution import Outcome, Seconds, Solution, as_asked
from models.errors import MachineError, TouchstoneError, TrajectoryError
from models.results.run import LONGEST, OWN_STEP
from models.trajectory_netcdf import write_netcdf
from validate.judge.time_step import load_step, step_defect
from validate.processes.disk import raise_if_disk_ended
from validate.store.store import progress
from validate.tasks.leg import Planned, StoredStage, leg_files, link_file
from validate.tasks.profile import Profile
from validate.tasks.records import Judged, finite, stage_record, with_certificate

if TYPE_CHECKING:
    from models.results.run import StageRecord
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.tasks.plugins import Plugin


# Fields of a record that depend on the plan only.
_OF_PLAN = (
    "metrics",
    "verdict",
    "why",
    "cause",
    "questions",
    "not_asked",
    "replay",
    "certificate",
    "certificate_missing",
)


@dataclass(frozen=True)
class SolvedStage:
    """A solved stage, with its wall and CPU seconds including the method's opening.

    elsewhere: part of these seconds spent by other runs, for stored stages.
    """

    planned: Planned
    solution: Solution
    wall: float
    cpu: float
    elsewhere: Seconds = field(default_factory=Seconds)

    @property
    def can_be_certified(self) -> bool:
        """Return whether the method claims exactness and has a plan."""
        return self.planned.method.exact and self.solution.trajectory is not None


def prepare(
    plugin: Plugin, scene: Scene, plan: tuple[Planned, ...], folder: Path, profile: Profile
) -> None:
    """Compile the scene, and open and close every method, so that no stage's time includes it."""
    progress(folder, "the compilation of the scene")
    _tried(lambda: plugin.compile(scene))
    profile.lap("compile")
    for planned in {planned.name: planned for planned in plan}.values():
        progress(folder, f"the preparation of {planned.name}")
        _tried(lambda planned=planned: planned.method.open(scene, planned.options).close())
    profile.lap("opening")


def _tried(preparation: Callable[[], object]) -> None:
    try:
        preparation()
    except MachineError:
        raise
    except Exception as error:  # noqa: BLE001 - the stage will raise it again
        raise_if_disk_ended(Path.cwd(), error)
        traceback.print_exc()


class OpenLeg:
    """The session of a leg; planned: one of its stages. The first stage includes the opening.

    Raises the method's errors.
    """

    def __init__(self, scene: Scene, planned: Planned) -> None:
        wall, cpu = time.perf_counter(), time.process_time()
        self._scene = scene
        self._session = planned.method.open(scene, planned.options)
        self._opening = (time.perf_counter() - wall, time.process_time() - cpu)
        self._stored_seconds = Seconds()

    def use_stored(self, stored: StoredStages) -> None:
        """Let the session use other pipelines' stored stages; count their seconds."""

        def counted(legs: Sequence[Leg]) -> Sequence[Solution] | None:
            stages = stored(legs)
            self._stored_seconds = sum(
                (stage.seconds for stage in stages or ()), self._stored_seconds
            )
            return stages

        self._session.use_stored(counted)

    def leaves(self, start: Trajectory | None) -> bool:
        """Return whether the first stage would replace this plan by the first guess."""
        wall, cpu = time.perf_counter(), time.process_time()
        cold = self._session.start_used(start) is None
        self._opening = (
            self._opening[0] + time.perf_counter() - wall,
            self._opening[1] + time.process_time() - cpu,
        )
        return cold

    def run(self, planned: Planned, start: Trajectory | None, time_limit: float) -> SolvedStage:
        """Run a stage.

        Raises the method's errors, TypeError for no Solution, TrajectoryError for a plan of another
        scene or duration.
        """
        wall, cpu = time.perf_counter() - self._opening[0], time.process_time() - self._opening[1]
        self._opening = (0.0, 0.0)
        solution = self._session.solve(eps=planned.eps, warm_start=start, time_limit=time_limit)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        if not isinstance(solution, Solution):
            raise TypeError(f"it must hand back a Solution, not {type(solution).__name__}.")
        if not isinstance(solution.outcome, Outcome):
            raise TypeError(
                f"the outcome of its Solution must be an Outcome, not {type(solution.outcome).__name__}."
            )
        if solution.trajectory is not None:
            solution.trajectory.check_fits(self._scene)
            horizon = self._scene.task.horizon
            # The judge compares the duration of a given plan with the task's (question 1).
            if planned.method.kind is not Kind.GIVEN and not math.isclose(
                solution.trajectory.duration, horizon, rel_tol=1e-9
            ):
                raise TrajectoryError(
                    f"plan: it lasts {solution.trajectory.duration:.6g} s, but the task of scene {self._scene.name} {horizon:.6g} s."
                )
            if planned.method.kind is Kind.DIRECT:
                solution = as_asked(self._scene, solution)
        elsewhere, self._stored_seconds = self._stored_seconds, Seconds()
        return SolvedStage(planned, solution, wall + elsewhere.wall, cpu + elsewhere.cpu, elsewhere)

    def close(self) -> None:
        """Close the session."""
        try:
            self._session.close()
        except Exception:  # noqa: BLE001 - a failed close must not lose the result; the log has the traceback
            traceback.print_exc()


class Judge:
    """Judges and certifies the plans of a run, and writes their files."""

    def __init__(self, plugin: Plugin, scene: Scene, profile: Profile) -> None:
        self._plugin, self._scene, self._profile = plugin, scene, profile
        self._fmu: Path | None = None

    def record(
        self,
        item: SolvedStage,
        folder: Path,
        index: int,
        before: float,
        same: StoredStage | None = None,
    ) -> StageRecord:
        """Return the record of stage `index` (from 0) without certificate; write its files.

        before [s]: of earlier stages; same: a stored stage with an identical plan, to copy from.
        """
        if same is None:
            judged = self._judged(item.solution.trajectory, folder, index + 1)
            of_plan: dict[str, object] = {"certificate_missing": item.can_be_certified}
        else:
            for what, path in same.files.items():
                link_file(path, folder / leg_files(index + 1)[what])
            judged = Judged(seconds=same.record.seconds.replay)
            of_plan = {name: getattr(same.record, name) for name in _OF_PLAN}
        record = stage_record(
            item.planned,
            item.solution,
            index,
            wall=item.wall,
            cpu=item.cpu,
            before=before,
            judged=judged,
        )
        if item.planned.method.kind is Kind.GIVEN:
            of_plan |= self._of_given(item.solution, judged)
        return replace(record, **of_plan)

    def _of_given(self, solution: Solution, judged: Judged) -> dict[str, object]:
        """Return the cost of a plan from a file, and how far it misses its own time step."""
        found: dict[str, object] = {
            "cost": None if judged.score is None else finite(judged.score.value("cost"))
        }
        reference = str(solution.options["time_step"])
        if not reference or solution.trajectory is None:
            return found
        try:
            step = load_step(reference)
            missed = step_defect(self._scene, step, solution.trajectory)
        except TouchstoneError as error:
            return found | {"message": str(error)}
        return found | {"residuals": {OWN_STEP: missed}}

    def _judged(self, trajectory: Trajectory | None, folder: Path, number: int) -> Judged:
        if trajectory is not None and self._fmu is None:
            self._fmu = self._plugin.build_fmu(self._scene)
        self._profile.lap("fmu_build")
        if trajectory is None or self._fmu is None:
            return Judged()
        plugin, scene, profile, names = self._plugin, self._scene, self._profile, leg_files(number)
        write_netcdf(folder / names["trajectory"], trajectory, scene)
        profile.lap("writing")
        began = time.perf_counter()
        try:
            judgement = plugin.judge(scene, self._fmu, trajectory)
            profile.lap("replay")
            seconds = time.perf_counter() - began
            replay = judgement.replay
            tracked = None if replay is None else replay.tracked
            for name, motion in (("replay", replay), ("tracked", tracked)):
                if motion is not None:
                    plugin.write_replay(folder / names[name], motion, scene, trajectory, LONGEST)
            if tracked is not None and tracked.feedback is not None:
                write_netcdf(
                    folder / names["trajectory"], trajectory, scene, tracked.feedback.gains
                )
            profile.lap("writing")
        except MachineError:
            raise
        except Exception as error:  # noqa: BLE001 - a failed judge must not lose the plan; the verdict is undecided
            raise_if_disk_ended(folder, error)
            traceback.print_exc()
            profile.lap("replay")
            return Judged(
                seconds=time.perf_counter() - began,
                problem=f"the judge ended with {type(error).__name__}: {first_line(error)}",
            )
        return Judged(replay=replay, score=judgement.score, seconds=seconds)

    def certified(self, record: StageRecord, item: SolvedStage) -> StageRecord:
        """Return the record with the certificate of its plan."""
        try:
            solution = self._plugin.certify(self._scene, item.solution)
        except Exception as error:  # noqa: BLE001 - a failed certificate must not lose the plan; the log has the traceback
            raise_if_disk_ended(Path.cwd(), error)
            traceback.print_exc()
            solution = item.solution
        self._profile.lap("certificate")
        return with_certificate(record, solution)


def in_words(error: Exception) -> str:
    """Return our error's sentence, else type and first line."""
    return (
        str(error)
        if isinstance(error, TouchstoneError)
        else f"{type(error).__name__}: {first_line(error)}"
    )


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text."""
    return next(iter(str(error).splitlines()), "") or "no further words."
