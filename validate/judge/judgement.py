"""Does this plan hold? One call from a plan to its verdict, for a scene or for anybody's FMU.

    from validate.judge.judgement import judge

    # a scene by name, file or object; a plan as CSV, NetCDF, arrays by name, DataFrame or Solution
    verdict = judge("three_cart", "plan.csv")
    print(verdict)  # holds: every question asked is answered yes; closest to its limit: ..
    verdict.holds, verdict.score.value("replay_error"), verdict.replay.t

The inputs alone are replayed first. Where they do not give the motion (question 4), a second replay follows it with limited feedback; where a plan that
declares no scheme fails, a third tells whether it was held the other way
(validate.judge.score.verdict).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from models.catalog import as_scene
from models.errors import TrajectoryError
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

# A plan so many times as long as the task of its scene has its times in another unit.
ANOTHER_UNIT = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """What the judge says of one plan: score.verdict, score.why and every metric.

    The replay that it speaks of (None without a plan).
    """

    scene: Subject
    plan: Trajectory | None
    replay: Replay | None
    score: Score

    @property
    def verdict(self) -> Verdict:
        """The verdict of the score."""
        return self.score.verdict

    @property
    def holds(self) -> bool:
        """Whether it holds, by its inputs alone or with feedback."""
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
    scene : Scene, or its name, or the path of its file
    plan : Trajectory | Solution | mapping or DataFrame of columns | path of a CSV or NetCDF file
        Columns are `t` (nodes,), then the scene's names; what is absent is not claimed (docs/replay.md).
    hold : "zero" or "linear" (or a Hold), the inputs within a step; scheme : the time step it is
    made of, by name (or a Scheme). Of columns and CSV only, where they do not say so. feedback :
    replay with feedback too, whether or not the verdict needs it. limits : run the FMU in a child
    with these limits; None runs it here.

    Raises
    ------
    SceneError, TrajectoryError, MachineError : in one sentence.
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
    """Judge a Trajectory, its times counted from its start, on the scene's FMU.

    feedback: replay with feedback even where the verdict does not need it. Raises TrajectoryError
        if the plan does not fit the scene or lasts a hundred
    times as long, MachineError.
    """
    plan = plan.from_zero()
    plan.check_fits(scene)
    if plan.duration > ANOTHER_UNIT * scene.task.horizon:
        raise TrajectoryError(
            f"plan: it takes {plan.duration:.4g} s, the task of {scene.name} {scene.task.horizon:.4g} s: it is no plan of that task; give its t in s."
        )

    scored: list[
        tuple[Replay, Score]
    ] = []  # what is not followed up is what comes back, and need not be scored twice

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
    """A plan judged by what `run` replays of it: with feedback where `track` says so, and held the other way where that may be why it fails.

    scored: replays whose score is known by then.
    """
    replayed = run(plan, track=track)
    result = next((known for opened, known in scored if opened is replayed), None) or score(
        subject, plan, replayed
    )
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
    """Somebody's FMU and a plan, brought together by a map; limits: of the child it runs in.

    own_step: judge one doStep a step of the plan.
    """

    package: Package
    foreign: Foreign
    plan: Trajectory
    limits: Limits
    own_step: bool

    def judge(self, feedback: bool = False) -> Judgement:
        """Replay the plan, in a child process, and judge it; feedback: replay with feedback too.

        Raises FmuError, MachineError, TrackingError.
        """
        run = partial(
            replay_foreign, self.foreign, self.package, limits=self.limits,
            own_step=self.own_step, decides=self._decides,
        )  # fmt: skip
        return _judged(self.foreign.model, self.plan, run, feedback)

    def _decides(self, plan: Trajectory, replayed: Replay) -> bool:
        """Whether no smaller error of this replay would change the verdict."""
        found = score(self.foreign.model, plan, replayed)
        unsure = [item for item in found.metrics if item.is_judged and item.ok is None]
        return found.verdict is not Verdict.UNDECIDED or all(item.value is None for item in unsure)


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
    """Bring somebody's FMU and a plan together.

    Parameters
    ----------
    fmu : the file, of FMI 2.0 or 3.0
    plan : path of a CSV | mapping or DataFrame of columns
    map_path : the file that says which column is which variable (docs/replay.md); equal names
        without it.
    hold : "zero" or "linear", the inputs within a step; None: as the plan or the map says.
    limits : of the child; None for the usual ones.
    own_step : judge Co-Simulation with one doStep a step of the plan, as who recorded the plan
        stepped it.
    ignore : columns of a CSV that are left out.

    Raises
    ------
    FmuError, MapError, TrajectoryError, MachineError : in one sentence.
    """
    # The names of an FMU's map need pydantic, which a replay on a scene does without: 0.1 s.
    from validate.judge.replay.map_schema import MapError, hint, read_map
    from validate.judge.replay.mapping import wire

    given = read_map(map_path) if map_path is not None else None
    for name in given.limits if given is not None else ():
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
    foreign, trajectory = wire(package, table, given, hold, where)
    if not own_step and any(
        foreign.variables.internal_step == reference
        for reference, _ in foreign.variables.parameters
    ):
        raise MapError(
            f"{where}: the parameter of the FMU's own step is chosen by the replay, ever smaller; with --own-step it may be given."
        )
    if own_step and trajectory.hold is Hold.LINEAR:
        raise TrajectoryError(
            f"{table.where}: its inputs are lines between its rows, but --own-step is for inputs that are held; leave it out."
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
    """A plan in any of the forms that `judge` takes; None of a Solution without one.

    ignore: columns of a CSV that are left out. Raises TrajectoryError.
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
    says_itself = (
        "Trajectory"
        if isinstance(plan, Trajectory)
        else "NetCDF file"
        if is_file and Path(plan).suffix == ".nc"
        else ""
    )
    if says_itself and (hold is not None or scheme is not None):
        raise TrajectoryError(
            f"plan: a {says_itself} says its own hold and scheme; change them in it."
        )
    if isinstance(plan, Trajectory):
        return plan
    if is_file:
        return (
            read_netcdf(Path(plan), scene)
            if says_itself
            else read_csv(Path(plan), scene, hold, scheme, ignore)
        )
    if isinstance(plan, (Mapping, np.ndarray)) or hasattr(plan, "columns"):
        return trajectory_from(ArrayTable(plan, hold=hold, scheme=scheme), scene)
    raise TrajectoryError(
        f"plan: a {type(plan).__name__} is no plan; give the path of a CSV, arrays by column name, a DataFrame, a Trajectory or a Solution."
    )
