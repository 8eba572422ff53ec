"""Judge a plan on a scene or on an external FMU, in one call.

    verdict = judge("three_cart", "plan.csv")
    print(verdict)  # holds: every question asked is answered yes; closest to its limit: ..
    verdict.holds, verdict.score.value("replay_error"), verdict.replay.t

The inputs alone are replayed first. A second replay, with limited feedback, follows if question 4
fails; a third, with the other hold, if a plan without a scheme fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from models.catalog import as_scene
from models.errors import SceneError, TrajectoryError
from models.fmu import build_fmu
from models.plan_table import ArrayTable, PlanTable, Table
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, read_csv, trajectory_from
from models.trajectory_netcdf import read_netcdf
from validate.fmi.description import Package, read_package
from validate.judge.replay import Replay
from validate.judge.replay.run import Track, replay, replay_foreign
from validate.judge.replay.subject import Foreign, Subject
from validate.judge.score import Score, metric_names, score, wants_feedback
from validate.judge.score.verdict import Question, Verdict
from validate.processes.isolated import Limits

# A plan this many times longer than its task has times in another unit.
ANOTHER_UNIT = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """The verdict, reasons and metrics of one plan; replay is None without a plan."""

    scene: Subject
    plan: Trajectory | None
    replay: Replay | None
    score: Score

    @property
    def verdict(self) -> Verdict:
        """Return the verdict of the score."""
        return self.score.verdict

    @property
    def holds(self) -> bool:
        """Return whether the plan holds, with or without feedback."""
        return self.score.verdict.is_good

    def __repr__(self) -> str:
        return self.score.sentence


def judge(
    scene: Scene | str | Path,
    plan: Trajectory | Mapping[str, Any] | str | Path | Any,
    *,
    hold: Hold | str | None = None,
    scheme: Scheme | str | None = None,
    feedback: bool = False,
    limits: Limits | None = None,
) -> Judgement:
    """Replay a plan on a scene and judge it.

    Parameters
    ----------
    scene
        Scene, its name, or the path of its file.
    plan
        Trajectory, Solution, mapping, DataFrame, or path of a CSV or NetCDF file. Columns: `t`
        (nodes,) and names of the scene; absent columns are not claimed (docs/replay.md).
    hold, scheme
        Hold ("zero" or "linear") and time step of columns and CSV that declare none.
    feedback
        Replay with feedback even if the verdict does not need it.
    limits
        Run the FMU in a child process with these limits; None: in this process.

    Raises
    ------
    SceneError, TrajectoryError, MachineError
        In one sentence.
    """
    subject = as_scene(scene)
    trajectory = as_trajectory(plan, subject, hold=hold, scheme=scheme)
    if trajectory is None:
        return Judgement(scene=subject, plan=None, replay=None, score=score(subject, None, None))
    return judge_trajectory(
        subject, build_fmu(subject), trajectory, feedback=feedback, limits=limits
    )


def judge_trajectory(
    scene: Scene,
    fmu: Path,
    plan: Trajectory,
    *,
    feedback: bool = False,
    limits: Limits | None = None,
) -> Judgement:
    """Judge a Trajectory, shifted to start at zero, on the scene's FMU.

    feedback: replay with feedback even if the verdict does not need it. Raises MachineError, and
    TrajectoryError if the plan does not fit the scene or is a hundred times as long.
    """
    plan = plan.from_zero()
    plan.check_fits(scene)
    if plan.duration > ANOTHER_UNIT * scene.task.horizon:
        raise TrajectoryError(
            f"plan: it lasts {plan.duration:.4g} s, but the task of {scene.name} lasts {scene.task.horizon:.4g} s. Give t in seconds."
        )

    scored: list[tuple[Replay, Score]] = []  # reused below

    def follow(opened: Replay) -> Trajectory | None:
        scored.append((opened, score(scene, plan, opened)))
        return plan if plan.has_states and wants_feedback(scored[-1][1].metrics) else None

    run = partial(replay, scene, fmu, limits=limits)
    return _judged(scene, plan, run, True if feedback else follow, scored)


def _judged(
    subject: Subject,
    plan: Trajectory,
    run: Callable[..., Replay],
    track: Track,
    scored: Sequence[tuple[Replay, Score]] = (),
) -> Judgement:
    """Judge a plan by replays of `run`: as `track` requires, and with the other hold.

    scored: replays with known scores.
    """
    replayed = run(plan, track=track)
    result = next(
        (known_score for opened, known_score in scored if opened is replayed), None
    ) or score(subject, plan, replayed)
    fails = (
        dict(result.questions).get(Question.MOTION) == "no"
        or result.verdict is Verdict.HOLDS_WITH_FEEDBACK
    )
    if plan.scheme is None and plan.u.shape[1] > 0 and fails:
        other = run(
            replace(plan, hold=Hold.LINEAR if plan.hold is Hold.ZERO_ORDER else Hold.ZERO_ORDER)
        )
        result = score(subject, plan, replayed, other_hold=other)
    return Judgement(scene=subject, plan=plan, replay=replayed, score=result)


@dataclass(frozen=True, kw_only=True, eq=False)
class WiredFmu:
    """An external FMU and a plan, connected by a map; limits: of the child process.

    own_step: judge one doStep per step of the plan.
    """

    package: Package
    foreign: Foreign
    plan: Trajectory
    limits: Limits
    own_step: bool

    def judge(self, feedback: bool = False) -> Judgement:
        """Replay the plan in a child process and judge it; feedback: replay with feedback too.

        Raises FmuError, MachineError, TrackingError.
        """
        run = partial(
            replay_foreign, self.foreign, self.package, limits=self.limits,
            own_step=self.own_step, decides=self._decides,
        )  # fmt: skip
        return _judged(self.foreign.model, self.plan, run, feedback)

    def _decides(self, plan: Trajectory, replayed: Replay) -> bool:
        """Return whether a smaller error of this replay cannot change the verdict."""
        result = score(self.foreign.model, plan, replayed)
        unsure = [item for item in result.metrics if item.is_judged and item.ok is None]
        return result.verdict is not Verdict.UNDECIDED or all(item.value is None for item in unsure)


def as_wired_fmu(
    scene: Any, plan: Any, map_path: str | Path | None, hold: str | None
) -> WiredFmu | None:
    """Return the FMU connected with the plan, None for a scene.

    Raises SceneError for a scene with a map, and the errors of `wire_fmu`.
    """
    if isinstance(scene, (str, Path)) and Path(scene).suffix.lower() == ".fmu":
        place = None if map_path is None else Path(map_path)
        return wire_fmu(Path(scene), plan, map_path=place, hold=hold)
    if map_path is not None:
        raise SceneError("map: a map belongs to an FMU; a scene knows its own names.")
    return None


def wire_fmu(
    fmu: Path,
    plan: Mapping[str, Any] | str | Path | Any,
    *,
    map_path: Path | None = None,
    hold: str | None = None,
    limits: Limits | None = None,
    own_step: bool = False,
    ignore: Sequence[str] = (),
) -> WiredFmu:
    """Connect an external FMU with a plan.

    Parameters
    ----------
    fmu
        FMU file, FMI 2.0 or 3.0.
    plan
        Path of a CSV, mapping or DataFrame of columns.
    map_path
        Map of columns to variables (docs/replay.md); None maps equal names.
    hold
        "zero" or "linear"; None: hold of the plan or the map.
    limits
        Limits of the child process.
    own_step
        Judge Co-Simulation with one doStep per step of the plan.
    ignore
        Columns of a CSV to leave out.

    Raises
    ------
    FmuError, MapError, TrajectoryError, MachineError
        In one sentence.
    """
    # pydantic takes 0.1 s to import, and a replay on a scene does not need it.
    from validate.judge.replay.map_schema import MapError, hint, read_map
    from validate.judge.replay.mapping import wire

    fmu_map = read_map(map_path) if map_path is not None else None
    for name in fmu_map.limits if fmu_map is not None else ():
        if name not in metric_names():
            raise MapError(
                f"map {map_path}: limits.{name}: there is no metric of that name{hint(name, metric_names())}."
            )
    package = read_package(fmu)
    where = f"map {map_path}" if map_path is not None else f"FMU {fmu}"
    if isinstance(plan, (str, Path)):
        table: Table = PlanTable(Path(plan), ignore)
    elif isinstance(plan, (Mapping, np.ndarray)) or hasattr(plan, "columns"):
        table = ArrayTable(plan)
    else:
        raise TrajectoryError(
            f"plan: a {type(plan).__name__} has no names for the variables of an FMU; give the path of a CSV, arrays by column name or a DataFrame."
        )
    foreign, trajectory = wire(package, table, fmu_map, hold, where)
    if not own_step and any(
        foreign.variables.internal_step == reference
        for reference, _ in foreign.variables.parameters
    ):
        raise MapError(
            f"{where}: the map sets the parameter of the FMU's own step, but the replay sets it to ever smaller steps. Remove it from the map, or give --own-step."
        )
    if own_step and trajectory.hold is Hold.LINEAR:
        raise TrajectoryError(
            f"{table.where}: its inputs are linear between rows, but --own-step requires inputs held over a step. Leave out --own-step."
        )
    return WiredFmu(
        package=package,
        foreign=foreign,
        plan=trajectory,
        limits=limits or Limits(),
        own_step=own_step,
    )


def as_trajectory(
    plan: Any,
    scene: Scene,
    *,
    hold: Hold | str | None = None,
    scheme: Scheme | str | None = None,
    ignore: Sequence[str] = (),
) -> Trajectory | None:
    """Return a plan in any form of `judge` as a Trajectory; None for a Solution without one.

    ignore: columns of a CSV to leave out. Raises TrajectoryError.
    """
    if hasattr(plan, "trajectory"):
        plan = plan.trajectory
        if plan is None:
            return None
        if not isinstance(plan, Trajectory):
            raise TrajectoryError(
                f"plan: its trajectory is a {type(plan).__name__}, but must be a Trajectory, or None."
            )
    is_file = isinstance(plan, (str, Path))
    declares = (
        "Trajectory"
        if isinstance(plan, Trajectory)
        else "NetCDF file"
        if is_file and Path(plan).suffix == ".nc"
        else ""
    )
    if declares and (hold is not None or scheme is not None):
        raise TrajectoryError(
            f"plan: a {declares} declares its own hold and scheme. Change them there."
        )
    if isinstance(plan, Trajectory):
        return plan
    if is_file:
        return (
            read_netcdf(Path(plan), scene)
            if declares
            else read_csv(Path(plan), scene, hold, scheme, ignore)
        )
    if isinstance(plan, (Mapping, np.ndarray)) or hasattr(plan, "columns"):
        return trajectory_from(ArrayTable(plan, hold=hold, scheme=scheme), scene)
    raise TrajectoryError(
        f"plan: a {type(plan).__name__} is no plan; give the path of a CSV, arrays by column name, a DataFrame, a Trajectory or a Solution."
    )
