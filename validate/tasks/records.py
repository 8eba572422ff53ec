"""Solution, Score and Replay -> the records that are stored (reports.records.record).

Numbers that are not finite never get into a record: a cost that is not a number is missing, and says so.

Certificate, starts and front of a Solution -> their records.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from formulations.solution import Bound, Outcome, Seconds, Solution
from reports.records.record import (
    BoundRecord,
    CertificateRecord,
    FrontPointRecord,
    MetricRecord,
    QuestionRecord,
    ReplayRecord,
    RunRecord,
    SceneRecord,
    SecondsRecord,
    SizeRecord,
    StageRecord,
    StartRecord,
    TrackedRecord,
    Verdict,
    thin,
)
from validate.tasks.paper import paper_row

if TYPE_CHECKING:
    from formulations.mpec import Certificate
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.records.record import LegRecord, ProvenanceRecord, StageRecord
    from validate.judge.score.verdict import Metric
    from validate.tasks.leg import Planned
    from validate.tasks.task import RunTask


def certificate_record(certificate: Certificate | None) -> CertificateRecord | None:
    """The record of a certificate, if there is one."""
    if certificate is None:
        return None
    return CertificateRecord(
        holds=certificate.holds,
        feasible=certificate.feasible,
        primal=finite(certificate.primal),
        worst=certificate.worst,
        complementarity=finite(certificate.complementarity),
        dual=finite(certificate.dual),
        letter=certificate.stationarity.letter,
        meaning=certificate.stationarity.value,
        pairs=certificate.pairs,
        biactive=certificate.biactive,
        least=finite(certificate.least),
        unique=certificate.unique,
        b_stationary=certificate.b_stationary,
        sentence=certificate.sentence,
    )


def start_records(solution: Solution) -> tuple[StartRecord, ...]:
    """The record of each start that a search tried."""
    return tuple(
        StartRecord(
            number=start.number,
            start=start.start,
            outcome=start.outcome.name.lower(),
            cost=finite(start.cost),
            windows=start.windows,
            seconds=start.seconds,
        )
        for start in solution.starts
    )


def front_records(scene: Scene, solution: Solution) -> tuple[FrontPointRecord, ...]:
    """The record of each point of a front of cost over terminal error."""
    return tuple(
        FrontPointRecord(
            tolerance=point.tolerance,
            outcome=point.solution.outcome.name.lower(),
            cost=finite(point.solution.cost),
            terminal_error=finite(point.solution.residuals.get("discrete_terminal_error")),
            windows=_windows(scene, point.solution.trajectory),
            certificate=certificate_record(point.solution.certificate),
        )
        for point in solution.front
    )


def with_certificate(record: StageRecord, scene: Scene, solution: Solution) -> StageRecord:
    """The record of the same stage, now that its plan and those of its front are certified."""
    certificate, front = certificate_record(solution.certificate), front_records(scene, solution)
    return record.model_copy(update={"certificate": certificate, "front": front, "certificate_missing": False})


def _windows(scene: Scene, plan: Trajectory | None) -> tuple[tuple[str, int, int], ...]:
    """(contact, first step, last step) of each time a force acts."""
    if plan is None:
        return ()
    found = []
    for contact, force in zip(scene.contacts, plan.lam.T, strict=False):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], force > 0, [False]]).astype(int)))
        found += [(contact.name, int(first), int(stop) - 1) for first, stop in zip(edges[::2], edges[1::2], strict=True)]
    return tuple(found)


# Lines of the log that go into the record, so that a report can show why a task ended as it did.
LOG_LINES = 40


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What the judge said of one plan: a Replay and a Score, or the sentence why there are none."""

    replay: Any = None
    score: Any = None
    seconds: float = 0.0
    problem: str = ""


def stage_record(
    scene: Scene, planned: Planned, solution: Solution, index: int, *, wall: float, cpu: float, before: float, judged: Judged
) -> StageRecord:
    """The record of a stage that ran, as of a pipeline of its leg alone.

    index: in its leg; wall, cpu [s]: of this stage; before [s]: of its leg's stages before it.
    """
    verdict, why = _verdict(solution, judged)
    return StageRecord(
        index=index,
        method=planned.name,
        method_title=planned.method.title,
        kind=planned.method.kind.value,
        eps=planned.eps,
        outcome=solution.outcome.name.lower(),
        advice=solution.outcome.value,
        message=solution.message,
        cost=finite(solution.cost),
        iterations=int(solution.iterations),
        residuals=_finite_values(solution.residuals),
        bound=_bound(solution.bound),
        size=_size(solution),
        solver=solution.solver,
        options=_options(solution.options or asdict(planned.options)),
        history=_history(solution.history),
        certificate=certificate_record(solution.certificate),
        starts=start_records(solution),
        front=front_records(scene, solution),
        seconds=_seconds(solution.seconds, wall, cpu, before, judged.seconds),
        metrics=tuple(_metric(metric) for metric in judged.score.metrics) if judged.score is not None else (),
        verdict=verdict,
        why=why,
        questions=_questions(judged.score),
        not_asked=() if judged.score is None else judged.score.not_asked,
        replay=_replay(judged.replay, judged.score) if judged.replay is not None else None,
        has_plan=solution.trajectory is not None,
    )


def stages_of(legs: Sequence[LegRecord], scene: str, pipeline: str) -> list[StageRecord]:
    """The stages of the legs of a run, as its own."""
    found: list[StageRecord] = []
    for leg in legs:
        before = found[-1].seconds.total if found else 0.0
        found += [
            record.model_copy(
                update={
                    "index": index,
                    "seconds": record.seconds.model_copy(update={"total": before + record.seconds.total}),
                    "paper": dict(paper_row(scene, pipeline, index)),
                    "shared_from": "" if leg.pipeline == pipeline else leg.pipeline,
                }
            )
            for index, record in enumerate(leg.stages, len(found))
        ]
    return found


def unfinished_stage(scene: str, pipeline: str, planned: Planned, outcome: Outcome, message: str) -> StageRecord:
    """The record of a stage without an answer: refused, crashed, out of time or never begun."""
    return StageRecord(
        index=planned.index,
        method=planned.name,
        method_title=planned.method.title,
        kind=planned.method.kind.value,
        eps=planned.eps,
        outcome=outcome.name.lower(),
        advice=outcome.value,
        message=message,
        options=_options(asdict(planned.options)),
        verdict="not applicable" if outcome is Outcome.REFUSED else "no plan",
        why=message,
        paper=dict(paper_row(scene, pipeline, planned.index)),
    )


def given_stage(name: str, judged: Judged, message: str = "") -> StageRecord:
    """The record of a plan that no method of ours found, as of a run of one stage. name: what the plan is called."""
    return StageRecord(
        index=0,
        method=name,
        method_title="A plan from elsewhere",
        kind="given",
        eps=None,
        outcome="given",
        advice="",
        message=message,
        cost=judged.score.value("cost"),
        seconds=SecondsRecord(replay=judged.seconds),
        metrics=tuple(_metric(metric) for metric in judged.score.metrics),
        verdict=judged.score.verdict.value,
        why=judged.score.why,
        questions=_questions(judged.score),
        not_asked=judged.score.not_asked,
        replay=_replay(judged.replay, judged.score) if judged.replay is not None else None,
        has_plan=judged.replay is not None,
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
    """The record of a task; its outcome, message and verdict are those of the last stage unless given. profile: wall seconds by phase."""
    last = stages[-1]
    return RunRecord(
        key=task.key,
        scene=scene,
        pipeline=task.pipeline.name,
        pipeline_title=task.pipeline.title,
        part=task.pipeline.part[0] if task.pipeline.part else 1,
        parts=task.pipeline.part[1] if task.pipeline.part else 1,
        stages=tuple(stages),
        outcome=last.outcome if outcome is None else outcome,
        message=last.message if message is None else message,
        verdict=last.verdict,
        must_hold=last.kind == "direct",
        wall_seconds=wall,
        cpu_seconds=cpu,
        profile=dict(profile),
        provenance=provenance,
        log_tail="\n".join(log.splitlines()[-LOG_LINES:]),
    )


def finite(value: Any) -> float | None:
    """The number if it is one, else None."""
    return float(value) if value is not None and math.isfinite(value) else None


def _verdict(solution: Solution, judged: Judged) -> tuple[Verdict, str]:
    if solution.trajectory is None:
        return "not applicable" if solution.outcome is Outcome.REFUSED else "no plan", solution.message or solution.outcome.value
    if judged.score is None:
        return "undecided", judged.problem
    verdict = judged.score.verdict
    return getattr(verdict, "value", verdict), judged.score.why


def _bound(bound: Bound | None) -> BoundRecord | None:
    return None if bound is None else BoundRecord(**asdict(bound))


def _size(solution: Solution) -> SizeRecord | None:
    size, paper = solution.size, solution.paper_size
    if size is None or paper is None:
        return None
    return SizeRecord(unknowns=size.unknowns, equations=size.equations, paper_unknowns=paper.unknowns, paper_equations=paper.equations)


def _replay(replay: Any, score: Any) -> ReplayRecord:
    error, growth, tracked = replay.error, getattr(replay, "growth", None), getattr(replay, "tracked", None)
    return ReplayRecord(
        error_estimate=_position(error.estimate),
        tolerance_difference=_position(error.tolerance),
        step_difference=_position(error.step),
        everyday_difference=_position(error.everyday),
        rollback_difference=_position(error.rollback),
        step_source=error.step_source,
        events=len(replay.events),
        seconds_reference=replay.seconds_reference,
        seconds_everyday=replay.seconds_everyday,
        fmu=replay.fmu,
        message=replay.message or replay.outcome.value,
        judged=getattr(score, "judged", "open"),
        growth_rate=None if growth is None else finite(growth.rate),
        tracked=None if tracked is None else _tracked(tracked),
    )


def _tracked(replay: Any) -> TrackedRecord:
    return TrackedRecord(
        error_estimate=_position(replay.error.estimate),
        events=len(replay.events),
        seconds_reference=replay.seconds_reference,
        seconds_everyday=replay.seconds_everyday,
        message=replay.message or replay.outcome.value,
        **asdict(replay.effort),
    )


def _position(difference: Any) -> float | None:
    return None if difference is None else finite(difference.position)


def _metric(metric: Metric) -> MetricRecord:
    numbers = {"value": finite(metric.value), "error": finite(metric.error), "limit": finite(metric.limit)}
    return MetricRecord(**{**asdict(metric), **numbers, "question": metric.question.number})


def _questions(score: Any) -> tuple[QuestionRecord, ...]:
    if score is None:
        return ()
    return tuple(QuestionRecord(number=question.number, text=question.value, answer=answer) for question, answer in score.questions)


def _seconds(seconds: Seconds, wall: float, cpu: float, before: float, replay: float) -> SecondsRecord:
    return SecondsRecord(
        build=seconds.build,
        translate=seconds.translate,
        evaluate=seconds.evaluate,
        linear_algebra=seconds.linear_algebra,
        solve=seconds.solve,
        stage=wall,
        stage_cpu=cpu,
        total=before + wall,
        replay=replay,
    )


def _finite_values(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if finite(value) is not None}


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
    """Columns thinned to what a plot can show; iterations in which any column is not finite are left out."""
    rows = [row for row in zip(*history.values(), strict=False) if all(map(math.isfinite, row))]
    kept = [rows[place] for place in thin(len(rows))]
    return {name: tuple(float(row[column]) for row in kept) for column, name in enumerate(history)}
