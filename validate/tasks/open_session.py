"""The session that is open in a cell: kept from stage to stage while method and options stay the same."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import MachineError, TrajectoryError
from validate.store.disk import raise_if_disk_ended
from validate.store.store import progress
from validate.tasks.judging import Solved
from validate.tasks.profile import Profile

if TYPE_CHECKING:
    from formulations.method import Method, Options, Session
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.tasks.plugins import Tools
    from validate.tasks.records import Planned


def stage_name(planned: Planned) -> str:
    return planned.name if planned.eps is None else f"{planned.name}, eps {planned.eps:g}"


def prepare(tools: Tools, scene: Scene, plan: tuple[Planned, ...], folder: Path, profile: Profile) -> None:
    """Compile the scene, and open and close every method once, so that neither that nor importing libraries counts in any stage's seconds."""
    progress(folder, "the compilation of the scene")
    _tried(lambda: tools.compile(scene))
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
    except Exception as error:  # noqa: BLE001 - it will happen again where it belongs, in the stage
        raise_if_disk_ended(Path.cwd(), error)
        traceback.print_exc()


class OpenSession:
    """See the module docstring."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._session: Session | None = None
        self._open: tuple[Method, Options] | None = None
        self._asked = (0.0, 0.0)  # wall and CPU seconds spent before the next stage that belong to it

    def starts_cold(self, planned: Planned, warm_start: Trajectory | None) -> bool:
        """Whether the stage, for which another session is opened, would leave this plan for the first guess."""
        wall, cpu = time.perf_counter(), time.process_time()
        cold = self._for(planned).start_used(warm_start) is None
        self._asked = (time.perf_counter() - wall, time.process_time() - cpu)
        return cold

    def run(self, planned: Planned, warm_start: Trajectory | None, time_limit: float) -> Solved:
        """Run a stage. Raises what its method raises, TypeError for an answer that is no Solution, TrajectoryError for a plan of another scene or of
        another duration."""
        from formulations.method import Kind
        from formulations.solution import Outcome, Solution, as_asked

        wall, cpu = time.perf_counter() - self._asked[0], time.process_time() - self._asked[1]
        self._asked = (0.0, 0.0)
        solution = self._for(planned).solve(eps=planned.eps, warm_start=warm_start, time_limit=time_limit)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        if not isinstance(solution, Solution):
            raise TypeError(f"it must hand back a Solution, not {type(solution).__name__}.")
        if not isinstance(solution.outcome, Outcome):
            raise TypeError(f"the outcome of its Solution must be an Outcome, not {type(solution.outcome).__name__}.")
        if solution.trajectory is not None:
            solution.trajectory.check_fits(self._scene)
            asked = self._scene.task.horizon
            if not math.isclose(solution.trajectory.duration, asked, rel_tol=1e-9):
                raise TrajectoryError(
                    f"plan: it lasts {solution.trajectory.duration:.6g} s, but the task of scene {self._scene.name} {asked:.6g} s."
                )
            if planned.method.kind is Kind.DIRECT:
                solution = as_asked(self._scene, solution)
        return Solved(planned, solution, wall, cpu)

    def close(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            try:
                session.close()
            except Exception:  # noqa: BLE001 - what was found is kept even if tidying up fails; the log has the traceback
                traceback.print_exc()

    def _for(self, planned: Planned) -> Session:
        wanted = (planned.method, planned.options)
        if self._session is None or self._open != wanted:
            self.close()
            self._session = planned.method.open(self._scene, planned.options)
            self._open = wanted
        return self._session
