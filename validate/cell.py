"""One cell: a scene by a pipeline. First everything is solved, then everything is replayed and scored, last come the certificates; so times are
clean, and a certificate that takes too long costs nothing else.

    record = run_cell(cell, provenance, folder)        # in a child process of its own: see validate.worker

Each stage starts from the plan of the stage before it (or of the last one that had a plan). Beside the record the folder holds
`trajectory.nc` and `replay.nc` of the last stage, and `trajectory_<n>.nc` and `replay_<n>.nc` of every other stage n (from 1); where there was a tracked
replay too, also `tracked.nc` and `tracked_<n>.nc`, and the gains with the trajectory.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from formulations.method import Pipeline
from formulations.pipeline import pipeline_from_json, pipeline_to_json
from models.errors import MachineError, TouchstoneError
from validate.judging import Solved, certified, first_line, has_plans, judge_all
from validate.profile import Profile
from validate.provisional import set_aside
from validate.shared_stages import Beginning, TakenOver, share, take_over
from validate.store import LOG, PROGRESS, raise_if_disk_ended
from validate.variant import Variant, varied

if TYPE_CHECKING:
    from formulations.method import Method, Session
    from formulations.solution import Outcome
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.record import ProvenanceRecord, RunRecord
    from validate.records import Planned
    from validate.tools import Tools

# A stage that gave no answer, why, and the sentence.
Unfinished: TypeAlias = "tuple[Planned, Outcome, str]"

# Of a cell's time limit, what is kept for certificates, replaying and scoring: a quarter, but no more than 60 s. The paper's scene needs 2 s;
# the certificate of two fingers takes 25 CPU s.
_JUDGING_SHARE, _JUDGING_MOST = 0.25, 60.0


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What is to be run. scene: a name or an absolute path of a scene file; variant: what a campaign file changes of it; tools: a dotted
    name (validate.tools); beginnings: those that other cells have too, the longest first."""

    key: str
    scene: str
    scene_name: str
    pipeline: Pipeline
    tools: str
    time_limit: float
    variant: Variant | None = None
    beginnings: tuple[Beginning, ...] = ()

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
            **({} if self.variant is None else {"variant": self.variant.to_json()}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Cell:
        variant = Variant.from_json(data["variant"]) if "variant" in data else None
        beginnings = tuple(Beginning(*item) for item in data["beginnings"])
        return cls(**{**data, "pipeline": pipeline_from_json(data["pipeline"]), "variant": variant, "beginnings": beginnings})


def run_cell(cell: Cell, provenance: ProvenanceRecord, folder: Path, began: float, profile: Profile | None = None) -> RunRecord:
    """Solve, judge and describe a cell. began: time.monotonic() at the start of the process, from which the time limit counts; profile: of
    the process until now.

    Raises MachineError where this machine cannot go on; whatever else goes wrong in a method or the judge is in the record.
    """
    from models.catalog import load_scene
    from validate.evidence_records import with_certificate
    from validate.records import planned_stages, run_record, stage_of, stage_record, unfinished_stage
    from validate.scene_record import scene_record
    from validate.tools import load_tools

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
    rest = _refused(scene, plan)
    taken = TakenOver() if rest else take_over(cell.beginnings, scene, len(plan), folder)
    profile.lap("shared")
    solved: list[Solved] = []
    if not rest and len(taken.stages) < len(plan):
        solved, rest = _solve(tools, scene, plan[len(taken.stages) :], taken.plan, deadline, folder, profile)
    _progress(folder, "the replay")
    judged = judge_all(tools, scene, solved, folder, len(plan), profile)
    stages = [stage_of(record, scene.name, cell.pipeline.name) for record in taken.stages]
    for item, verdict in zip(solved, judged, strict=True):
        before = stages[-1].seconds.total if stages else 0.0
        record = stage_record(
            scene, cell.pipeline.name, item.planned, item.solution, wall=item.wall, cpu=item.cpu, before=before, judged=verdict
        )
        stages.append(record)
    unfinished = [unfinished_stage(scene.name, cell.pipeline.name, planned, outcome, message) for planned, outcome, message in rest]
    drawn = scene_record(scene)
    cause = rest[0][2] if rest else None  # the stages after it only say that it came before them

    def told() -> RunRecord:
        log = folder / LOG
        profile.lap("record")
        text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        wall, cpu = profile.total, time.process_time()
        return run_record(
            cell, drawn, [*stages, *unfinished], provenance, wall=wall, cpu=cpu, log=text, message=cause, profile=profile.seconds
        )

    exact = [item for item in solved if item.planned.method.exact and has_plans(item.solution)]
    for place, item in enumerate(exact):
        index = item.planned.index
        set_aside(folder, told(), [later.planned.index for later in exact[place:]])
        _progress(folder, f"the certificate of stage {index + 1} ({_stage_name(item.planned)})")
        stages[index] = with_certificate(stages[index], scene, certified(tools, scene, item).solution)
        profile.lap("certificate")
    share(cell.beginnings, cell.pipeline.name, stages, len(taken.stages), len(plan), folder)
    profile.lap("shared")
    return told()


def _progress(folder: Path, text: str) -> None:
    """Say where we are, for the parent to read if we never come back."""
    (folder / PROGRESS).write_text(text, encoding="utf-8")


def _refused(scene: Scene, plan: tuple[Planned, ...]) -> list[Unfinished]:
    """Every stage, if one of the methods does not apply to the scene; else none."""
    from formulations.solution import Outcome

    for planned in plan:
        reason = planned.method.accepts(scene)
        if reason is not None:
            return [(other, Outcome.REFUSED, f"{planned.name}: {reason}") for other in plan]
    return []


def _solve(
    tools: Tools, scene: Scene, plan: tuple[Planned, ...], warm_start: Trajectory | None, deadline: float, folder: Path, profile: Profile
) -> tuple[list[Solved], list[Unfinished]]:
    """Run these stages in order, the first from a plan. Returns those that ran, and (planned, outcome, message) of those that did not."""
    from formulations.solution import Outcome

    _prepare(tools, scene, plan, folder, profile)
    solved: list[Solved] = []
    opened = _Opened(scene)
    try:
        for place, planned in enumerate(plan):
            left = deadline - time.monotonic()
            if left <= 0:
                message = "the cell's time was used up before this stage."
                return solved, [(other, Outcome.TIME_LIMIT, message) for other in plan[place:]]
            _progress(folder, f"stage {planned.index + 1} ({_stage_name(planned)})")
            try:
                item = opened.run(planned, warm_start, left)
            except MachineError:
                raise
            except Exception as error:  # noqa: BLE001 - a method may fail in any way; the log has the traceback, the row has the sentence
                raise_if_disk_ended(folder, error)
                traceback.print_exc()
                profile.lap("solve_rest")
                outcome = Outcome.FAILED if isinstance(error, TouchstoneError) else Outcome.CRASHED
                message = (
                    str(error) if isinstance(error, TouchstoneError) else f"{type(error).__name__} in {planned.name}: {first_line(error)}"
                )
                later = f"not begun, because stage {planned.index + 1} ({_stage_name(planned)}) gave no answer."
                rest = [(other, outcome, message if other is planned else later) for other in plan[place:]]
                return solved, rest
            spent = item.solution.seconds
            profile.split({name: getattr(spent, name) for name in ("build", "translate", "evaluate", "linear_algebra")}, rest="solve_rest")
            solved.append(item)
            warm_start = item.solution.trajectory or warm_start
    finally:
        opened.close()
    return solved, []


def _prepare(tools: Tools, scene: Scene, plan: tuple[Planned, ...], folder: Path, profile: Profile) -> None:
    """Compile the scene, and open and close every method once, so that neither that nor importing libraries counts in any stage's seconds."""
    _progress(folder, "the compilation of the scene")
    _tried(lambda: tools.compile(scene))
    profile.lap("compile")
    for planned in {planned.name: planned for planned in plan}.values():
        _progress(folder, f"the preparation of {planned.name}")
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


def _stage_name(planned: Planned) -> str:
    return planned.name if planned.eps is None else f"{planned.name}, eps {planned.eps:g}"


class _Opened:
    """The session that is open: kept from stage to stage while method and options stay the same."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._session: Session | None = None
        self._open: tuple[Method, dict[str, object]] | None = None

    def run(self, planned: Planned, warm_start: Any, time_limit: float) -> Solved:
        from formulations.solution import Solution

        wall, cpu = time.perf_counter(), time.process_time()
        wanted = (planned.method, dict(planned.options))
        if self._session is None or self._open != wanted:
            self.close()
            self._session = planned.method.open(self._scene, planned.options)
            self._open = wanted
        solution = self._session.solve(eps=planned.eps, warm_start=warm_start, time_limit=time_limit)
        solved = Solved(planned, solution, time.perf_counter() - wall, time.process_time() - cpu)
        if not isinstance(solution, Solution):
            raise TypeError(f"it must hand back a Solution, not {type(solution).__name__}.")
        if solution.trajectory is not None:
            solution.trajectory.check_fits(self._scene)
        return solved

    def close(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            try:
                session.close()
            except Exception:  # noqa: BLE001 - what was found is kept even if tidying up fails; the log has the traceback
                traceback.print_exc()
