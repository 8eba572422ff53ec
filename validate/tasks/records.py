"""Convert Solution, Score and Replay into stored records, without non-finite numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from formulations.solution import Outcome, Solution
from models.results.run import (
    LONGEST_HISTORY,
    CertificateRecord,
    ReplayRecord,
    RunRecord,
    SceneRecord,
    Seconds,
    StageRecord,
    TrackedRecord,
    thin,
)
from models.results.verdict import Verdict
from validate.tasks.paper import paper_row

if TYPE_CHECKING:
    from formulations.certificate.certificate import Certificate
    from models.results.run import LegRecord, ProvenanceRecord
    from models.trajectory import Trajectory
    from validate.judge.replay import Difference, Replay
    from validate.judge.score import Score
    from validate.tasks.leg import Planned
    from validate.tasks.task import RunTask


def certificate_record(certificate: Certificate | None) -> CertificateRecord | None:
    """Return the summary of a certificate, if there is one: its own answers, not its tolerances."""
    if certificate is None:
        return None
    found: dict[str, Any] = {
        item.name: getattr(certificate, item.name) for item in fields(CertificateRecord)
    }
    numbers: dict[str, Any] = {
        name: finite(found[name]) for name in ("primal", "complementarity", "dual")
    }
    return CertificateRecord(**(found | numbers))


def with_certificate(record: StageRecord, solution: Solution) -> StageRecord:
    """Return the record with the certificate of its plan."""
    certificate = certificate_record(solution.certificate)
    return replace(record, certificate=certificate, certificate_missing=False)


# Last lines of the log that a record keeps.
LOG_LINES = 40


@dataclass(frozen=True, kw_only=True)
class Judged:
    """The judge's result of one plan, or why there is none."""

    replay: Replay | None = None
    score: Score | None = None
    seconds: float = 0.0
    problem: str = ""


def stage_record(
    planned: Planned,
    solution: Solution,
    index: int,
    *,
    wall: float,
    cpu: float,
    before: float,
    judged: Judged,
) -> StageRecord:
    """Return the record of a solved stage, as in a pipeline of its leg alone.

    index: in its leg; wall, cpu [s]: of this stage; before [s]: of earlier stages.
    """
    verdict, why = _verdict(solution, judged)
    return StageRecord(
        **_asked(planned, solution.outcome),
        index=index,
        message=solution.message,
        cost=finite(solution.cost),
        iterations=int(solution.iterations),
        residuals={
            name: float(value)
            for name, value in solution.residuals.items()
            if finite(value) is not None
        },
        size=solution.size,
        paper_size=solution.paper_size,
        solver=solution.solver,
        options=_options(solution.options or asdict(planned.options)),
        history=_history(solution.history),
        certificate=certificate_record(solution.certificate),
        seconds=replace(
            solution.seconds, wall=wall, cpu=cpu, total=before + wall, replay=judged.seconds
        ),
        verdict=verdict,
        why=why,
        has_plan=solution.trajectory is not None,
        **_of_score(judged),
    )


def _asked(planned: Planned, outcome: Outcome) -> dict[str, Any]:
    method = planned.method
    named = {
        "method": planned.name,
        "method_title": method.title,
        "kind": method.kind.value,
        "eps": planned.eps,
    }
    return {**named, "outcome": outcome.name.lower(), "advice": outcome.value}


def solution_of(record: StageRecord, plan: Trajectory | None) -> Solution:
    """Return the Solution of a stage's record; plan: its trajectory."""
    return Solution(
        method=record.method,
        outcome=Outcome[record.outcome.upper()],
        message=record.message,
        trajectory=plan,
        cost=record.cost,
        iterations=record.iterations,
        seconds=record.seconds,
        residuals=record.residuals,
        solver=record.solver,
        options=record.options,
        history=record.history,
        size=record.size,
        paper_size=record.paper_size,
    )


def stages_of(legs: Sequence[LegRecord], scene: str, pipeline: str) -> list[StageRecord]:
    """Return the stages of legs as those of a run."""
    stages: list[StageRecord] = []
    for leg in legs:
        before = stages[-1].seconds.total if stages else 0.0
        stages += [
            replace(
                record,
                index=index,
                seconds=replace(record.seconds, total=before + record.seconds.total),
                paper=dict(paper_row(scene, pipeline, index)),
                shared_from="" if leg.pipeline == pipeline else leg.pipeline,
            )
            for index, record in enumerate(leg.stages, len(stages))
        ]
    return stages


def unfinished_stage(
    scene: str, pipeline: str, planned: Planned, outcome: Outcome, message: str
) -> StageRecord:
    """Return the record of a stage without an answer: refused, crashed, out of time, not begun."""
    return StageRecord(
        **_asked(planned, outcome),
        index=planned.index,
        message=message,
        options=_options(asdict(planned.options)),
        verdict=_without_plan(outcome),
        why=message,
        paper=dict(paper_row(scene, pipeline, planned.index)),
    )


def given_stage(
    name: str, replay: Replay | None, score: Score, seconds: float, message: str = ""
) -> StageRecord:
    """Return the record of an external plan; seconds [s]: CPU time of its replays."""
    return StageRecord(
        index=0,
        method=name,
        method_title="A plan from elsewhere",
        kind="given",
        eps=None,
        outcome="given",
        advice="",
        message=message,
        cost=score.value("cost"),
        seconds=Seconds(replay=seconds),
        verdict=score.verdict,
        why=score.why,
        has_plan=replay is not None,
        **_of_score(Judged(replay=replay, score=score)),
    )


def run_record(
    task: RunTask,
    scene: SceneRecord,
    stages: Sequence[StageRecord],
    provenance: ProvenanceRecord,
    *,
    wall: float,
    cpu: float,
    log: str,
    outcome: str | None = None,
    message: str | None = None,
    profile: Mapping[str, float] = MappingProxyType({}),
) -> RunRecord:
    """Return the record of a task, by default with outcome and message of the last stage.

    profile: wall seconds by phase.
    """
    last = stages[-1]
    return RunRecord(
        key=task.key,
        scene=scene,
        pipeline=task.pipeline.name,
        pipeline_title=task.pipeline.title,
        stages=tuple(stages),
        outcome=last.outcome if outcome is None else outcome,
        message=last.message if message is None else message,
        verdict=last.verdict,
        instance=task.instance,
        judged_by=task.judged_by,
        must_hold=last.kind == "direct",
        wall_seconds=wall,
        cpu_seconds=cpu,
        profile=dict(profile),
        provenance=provenance,
        log_tail="\n".join(log.splitlines()[-LOG_LINES:]),
    )


def finite(value: float | None) -> float | None:
    """Return a finite number as float, else None."""
    return float(value) if value is not None and math.isfinite(value) else None


def _verdict(solution: Solution, judged: Judged) -> tuple[Verdict, str]:
    if solution.trajectory is None:
        return _without_plan(solution.outcome), solution.message or solution.outcome.value
    if judged.score is None:
        return Verdict.UNDECIDED, judged.problem
    return judged.score.verdict, judged.score.why


def _without_plan(outcome: Outcome) -> Verdict:
    return Verdict.NOT_APPLICABLE if outcome is Outcome.REFUSED else Verdict.NO_PLAN


def _replay(replay: Replay, score: Score | None) -> ReplayRecord:
    error, growth, tracked = replay.error, replay.growth, replay.tracked
    return ReplayRecord(
        **_of_replay(replay),
        tolerance_difference=_position(error.tolerance),
        step_difference=_position(error.step),
        everyday_difference=_position(error.everyday),
        fmu=replay.fmu,
        judged="open" if score is None else score.judged,
        growth_rate=None if growth is None else finite(growth.rate),
        tracked=None
        if tracked is None or tracked.effort is None
        else TrackedRecord(**_of_replay(tracked), **asdict(tracked.effort)),
    )


def _of_replay(replay: Replay) -> dict[str, Any]:
    return {
        "error_estimate": _position(replay.error.estimate),
        "events": len(replay.events),
        "seconds_reference": replay.seconds_reference,
        "seconds_everyday": replay.seconds_everyday,
        "message": replay.message or replay.outcome.value,
    }


def _position(difference: Difference | None) -> float | None:
    return None if difference is None else finite(difference.position)


def _of_score(judged: Judged) -> dict[str, Any]:
    fields: dict[str, Any] = (
        {} if judged.replay is None else {"replay": _replay(judged.replay, judged.score)}
    )
    if judged.score is not None:
        fields |= {
            "metrics": judged.score.metrics,
            "questions": judged.score.questions,
            "not_asked": judged.score.not_asked,
            "cause": judged.score.cause,
        }
    return fields


def _options(options: Mapping[str, object]) -> dict[str, Any]:
    return {name: _plain(value) for name, value in options.items()}


def _plain(value: object) -> Any:
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else repr(value)
    if isinstance(value, Iterable):
        items = list(value)
        if all(isinstance(item, (int, float)) and math.isfinite(item) for item in items):
            return [float(item) for item in items]
    return str(value)


def _history(history: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    rows = [row for row in zip(*history.values(), strict=False) if all(map(math.isfinite, row))]
    kept = [rows[place] for place in thin(len(rows), LONGEST_HISTORY)]
    return {name: tuple(float(row[column]) for row in kept) for column, name in enumerate(history)}
