"""The stages of a cell as they come: taken over from other cells, solved, judged, certified, and shared with others as soon as they are whole.

stages = CellStages(cell, tools, scene, plan, folder, profile)
unfinished = stages.solve(deadline)     # what other cells begin with is judged and shared at once
stages.judge()                          # all the rest
stages.certify(told)                    # told: makes the record of the cell as far as it is known
stages.records
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from models.errors import MachineError, TouchstoneError
from validate.store.disk import raise_if_disk_ended
from validate.store.store import progress
from validate.tasks.judging import Judge, Solved, certified, first_line, has_plans
from validate.tasks.open_session import OpenSession, prepare, stage_name
from validate.tasks.profile import Profile
from validate.tasks.provisional import set_aside
from validate.tasks.shared_stages import Beginning, TakenOver, is_late, is_sure, share, take_over

if TYPE_CHECKING:
    from formulations.solution import Outcome
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.records.record import RunRecord, StageRecord
    from validate.tasks.plugins import Tools
    from validate.tasks.records import Planned
    from validate.tasks.run import Cell

# A stage that gave no answer, why, and the sentence.
Unfinished: TypeAlias = "tuple[Planned, Outcome, str]"


def refused(scene: Scene, plan: tuple[Planned, ...]) -> list[Unfinished]:
    """Every stage, if one of the methods does not apply to the scene; else none."""
    from formulations.solution import Outcome

    for planned in plan:
        reason = planned.method.accepts(scene)
        if reason is not None:
            return [(other, Outcome.REFUSED, f"{planned.name}: {reason}") for other in plan]
    return []


class CellStages:
    """See the module docstring. records: of the stages that ran and were judged, in order."""

    def __init__(self, cell: Cell, tools: Tools, scene: Scene, plan: tuple[Planned, ...], folder: Path, profile: Profile) -> None:
        self._cell, self._tools, self._scene, self._plan, self._folder, self._profile = cell, tools, scene, plan, folder, profile
        self.records: list[StageRecord] = []
        self._judge = Judge(tools, scene, folder, len(plan), profile)
        self._solved: list[Solved] = []  # not yet judged
        self._uncertified: list[Solved] = []  # judged, and has a plan to certify
        self._to_share: list[Beginning] = []
        self._start: Trajectory | None = None
        self._opened = OpenSession(scene)

    def solve(self, deadline: float) -> list[Unfinished]:
        """Take over or run all stages in order; (planned, outcome, message) of those that did not run. deadline: time.monotonic() by which
        solving ends; what is judged in between does not count."""
        taken = take_over(self._cell.beginnings, self._scene, len(self._plan), self._folder, self._cell.time_limit)
        self._accept(taken)
        self._to_share = [item for item in self._cell.beginnings if item.stages > len(self.records)]
        self._profile.lap("shared")
        if taken.late:
            return self._out_of_time()
        if self._done == len(self._plan):
            return []
        prepare(self._tools, self._scene, self._plan[self._done :], self._folder, self._profile)
        try:
            while self._done < len(self._plan):
                left = deadline - time.monotonic()
                if left <= 0:
                    self._share_late()
                    return self._out_of_time()
                planned = self._plan[self._done]
                progress(self._folder, f"stage {planned.index + 1} ({stage_name(planned)})")
                try:
                    restarts = self._cold_restarts(planned)
                    taken = take_over(restarts, self._scene, len(self._plan), self._folder)
                    if not taken.stages:
                        self._run(planned, left)
                except MachineError:
                    raise
                except Exception as error:  # noqa: BLE001 - a method may fail in any way; the log has the traceback, the row has the sentence
                    return self._failed(planned, error)
                solved = time.monotonic()
                if taken.stages:
                    self.judge()
                    self._accept(taken)
                else:
                    self._to_share += restarts
                    self._share_what_ends_here()
                deadline += time.monotonic() - solved
            if time.monotonic() >= deadline:
                self._share_late()
        finally:
            self._opened.close()
        return []

    def judge(self) -> None:
        """Replay and score what is solved and was not yet judged, and share what is whole with that."""
        solved, self._solved = self._solved, []
        self._judge_these(solved)
        self._share()

    def certify(self, told: Callable[[], RunRecord]) -> None:
        """Certify the plans of exact methods, each shared when it is done; before each, what is known is set aside."""
        from validate.tasks.records import with_certificate

        while self._uncertified:
            item, index = self._uncertified[0], self._uncertified[0].planned.index
            set_aside(self._folder, told(), [later.planned.index for later in self._uncertified])
            progress(self._folder, f"the certificate of stage {index + 1} ({stage_name(item.planned)})")
            solution = certified(self._tools, self._scene, item).solution
            self.records[index] = with_certificate(self.records[index], self._scene, solution)
            del self._uncertified[0]
            self._profile.lap("certificate")
            self._share()

    @property
    def _done(self) -> int:
        """How many stages are taken over or solved."""
        return len(self.records) + len(self._solved)

    def _accept(self, taken: TakenOver) -> None:
        """Stages of another cell as the next of this."""
        from validate.tasks.records import stage_of

        before = self.records[-1].seconds.total if self.records else 0.0
        for record in taken.stages:
            self.records.append(stage_of(record, self._scene.name, self._cell.pipeline.name, before))
        self._start = taken.plan or self._start

    def _cold_restarts(self, planned: Planned) -> list[Beginning]:
        """What others begin with this stage, if it leaves its plan for the first guess as theirs does."""
        wanted = [item for item in self._cell.restarts if item.first == planned.index]
        return wanted if wanted and self._opened.starts_cold(planned, self._start) else []

    def _run(self, planned: Planned, left: float) -> None:
        item = self._opened.run(planned, self._start, left)
        spent = item.solution.seconds
        self._profile.split(
            {name: getattr(spent, name) for name in ("build", "translate", "evaluate", "linear_algebra")}, rest="solve_rest"
        )
        self._solved.append(item)
        self._start = item.solution.trajectory or self._start

    def _share_what_ends_here(self) -> None:
        """Judge what other cells begin with and share it, unless a certificate is still to come."""
        ending = [item for item in self._to_share if item.stages == self._done]
        if any(not any(planned.method.exact for planned in self._plan[item.first : item.stages]) for item in ending):
            progress(self._folder, "the replay of what other cells begin with")
            self.judge()

    def _judge_these(self, solved: list[Solved]) -> None:
        from validate.tasks.records import stage_record

        for item, verdict in zip(solved, self._judge.judge_all(solved), strict=True):
            before = self.records[-1].seconds.total if self.records else 0.0
            name = self._cell.pipeline.name
            self.records.append(
                stage_record(self._scene, name, item.planned, item.solution, wall=item.wall, cpu=item.cpu, before=before, judged=verdict)
            )
            if item.planned.method.exact and has_plans(item.solution):
                self._uncertified.append(item)

    def _share(self) -> None:
        """Those of the wanted stages that are judged and certified, if another run would find the same."""
        awaiting = {item.planned.index for item in self._uncertified}
        for item in tuple(self._to_share):
            if item.stages <= len(self.records) and not awaiting & set(range(item.first, item.stages)):
                self._to_share.remove(item)
                records = self.records[item.first : item.stages]
                if is_sure(records):
                    share(item, self._cell.pipeline.name, records, len(self._plan), self._folder)
        self._profile.lap("shared")

    def _share_late(self) -> None:
        """What used up all the time of this cell, from its start on."""
        self.judge()
        wanted = [item for item in self._cell.beginnings if item.stages >= len(self.records)]
        if wanted and is_late(self.records) and not self._uncertified and not any(record.shared_from for record in self.records):
            share(wanted[-1], self._cell.pipeline.name, self.records, len(self._plan), self._folder, self._cell.time_limit)
        self._profile.lap("shared")

    def _out_of_time(self) -> list[Unfinished]:
        from formulations.solution import Outcome

        message = "the cell's time was used up before this stage."
        return [(planned, Outcome.TIME_LIMIT, message) for planned in self._plan[self._done :]]

    def _failed(self, planned: Planned, error: Exception) -> list[Unfinished]:
        from formulations.solution import Outcome

        raise_if_disk_ended(self._folder, error)
        traceback.print_exc()
        self._profile.lap("solve_rest")
        outcome = Outcome.FAILED if isinstance(error, TouchstoneError) else Outcome.CRASHED
        message = str(error) if isinstance(error, TouchstoneError) else f"{type(error).__name__} in {planned.name}: {first_line(error)}"
        later = f"not begun, because stage {planned.index + 1} ({stage_name(planned)}) gave no answer."
        return [(other, outcome, message if other is planned else later) for other in self._plan[planned.index :]]
