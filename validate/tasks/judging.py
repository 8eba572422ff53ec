"""What is said of the plans of a cell once all of them are found: replay, score, certificate; and the files written with them."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import MachineError
from reports.records.record import stage_files
from validate.store.disk import raise_if_disk_ended
from validate.tasks.profile import Profile

if TYPE_CHECKING:
    from formulations.solution import Solution
    from models.scene import Scene
    from validate.tasks.plugins import Tools
    from validate.tasks.records import Judged, Planned


@dataclass(frozen=True)
class Solved:
    """A stage that ran: its solution and the wall and CPU seconds it took, opening the method included."""

    planned: Planned
    solution: Solution
    wall: float
    cpu: float


def has_plans(solution: Solution) -> bool:
    """Whether there is something to certify: its own plan, or one of its front, of which that of the smallest tolerance is its own."""
    return solution.trajectory is not None or any(point.solution.trajectory is not None for point in solution.front)


def certified(tools: Tools, scene: Scene, item: Solved) -> Solved:
    """The stage with the certificate of its plan, where its method claims to solve the exact problem."""
    if not item.planned.method.exact:
        return item
    try:
        return replace(item, solution=tools.certify(scene, item.solution))
    except Exception as error:  # noqa: BLE001 - the plan is kept even if its judge stumbles; it then has no certificate, and the log has the traceback
        raise_if_disk_ended(Path.cwd(), error)
        traceback.print_exc()
        return item


class Judge:
    """Replays and scores plans of a cell of so many stages, and writes their files into its folder."""

    def __init__(self, tools: Tools, scene: Scene, folder: Path, stages: int, profile: Profile) -> None:
        self._tools, self._scene, self._folder, self._stages, self._profile = tools, scene, folder, stages, profile
        self._fmu: Path | None = None

    def judge_all(self, solved: list[Solved]) -> list[Judged]:
        """Replay and score of every plan, in order."""
        if self._fmu is None and any(item.solution.trajectory is not None for item in solved):
            self._fmu = self._tools.build_fmu(self._scene)
        self._profile.lap("fmu_build")
        return [_judge(self._tools, self._scene, self._fmu, item, self._folder, self._stages, self._profile) for item in solved]


def _judge(tools: Tools, scene: Scene, fmu: Path | None, item: Solved, folder: Path, stages: int, profile: Profile) -> Judged:
    from models.trajectory_netcdf import write_netcdf
    from validate.tasks.records import Judged

    trajectory = item.solution.trajectory
    if trajectory is None or fmu is None:
        return Judged()
    names = stage_files(item.planned.index, stages)
    write_netcdf(folder / names["trajectory"], trajectory, scene)
    profile.lap("writing")
    began = time.perf_counter()
    try:
        judgement = tools.judge(scene, fmu, trajectory)
        profile.lap("replay")
        seconds = time.perf_counter() - began
        replay = judgement.replay
        tools.write_replay(folder / names["replay"], replay, scene)
        tracked = getattr(replay, "tracked", None)
        if tracked is not None:
            tools.write_replay(folder / names["tracked"], tracked, scene)
            write_netcdf(folder / names["trajectory"], trajectory, scene, tracked.feedback.gains)
        profile.lap("writing")
    except MachineError:
        raise
    except Exception as error:  # noqa: BLE001 - the plan is kept even if the judge stumbles; the verdict is then undecided
        raise_if_disk_ended(folder, error)
        traceback.print_exc()
        profile.lap("replay")
        return Judged(seconds=time.perf_counter() - began, problem=f"the judge ended with {type(error).__name__}: {first_line(error)}")
    return Judged(replay=replay, score=judgement.score, seconds=seconds)


def first_line(error: BaseException) -> str:
    """The first line of what an error says."""
    return next(iter(str(error).splitlines()), "") or "no further words."
