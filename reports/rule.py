"""What makes a campaign fail: in words, and as a function of its records. `validate all` and the report say and do the same.

failures(runs, examinations)           # one sentence each; none: exit code 0
findings(runs)                         # what the replay found of plans that are no failure
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the words are shown by --help, which must not cost pydantic
    from reports.examination_record import ExaminationRecord
    from reports.record import RunRecord, StageRecord

# What fails a campaign, each ending a sentence that begins "A campaign fails if".
RULE = (
    "a cell crashed, or failed in a way that its method does not explain, whatever the method",
    "a direct method says that it solved the scene, and its plan violates a limit or is not resolved by the replay",
    "a plan of a direct method stands beside a row of the paper, and does not hold",
    "direct methods ran on a scene, and no cell of that scene holds",
    "an examination (a check of one of our own FMUs, a hard case) finds what must not be, or ends without an answer",
)
# What does not.
RESULTS = (
    "A method that says itself that it stopped at a limit, stalled, diverged, found no plan or does not apply to the scene has given a result, "
    "not a failure.",
    "A relaxed (indirect) method is expected to violate contact physics: the report shows by how much.",
    "A plan that keeps every limit of the discrete problem that its method solved, along a motion so unstable that it is judged with tracking "
    "feedback, and that the feedback does not hold, is a finding about the scene's time step: its row says violates and it is named, but no "
    "method broke its word.",
    "A scene without inputs has nothing to plan: its free motion is replayed and judged by its closed forms.",
)


def failures(runs: Sequence[RunRecord], examinations: Sequence[ExaminationRecord] = ()) -> tuple[str, ...]:
    """Why the campaign of these records fails, by `RULE`; a sentence for each cell or scene."""
    found = [sentence for run in runs if (sentence := _cell_failure(run))]
    for scene in dict.fromkeys(run.scene.name for run in runs):
        found += _scene_failure(scene, [run for run in runs if run.scene.name == scene])
    found += [_examined(record) for record in examinations if not record.passed]
    return tuple(found)


def findings(runs: Iterable[RunRecord]) -> tuple[str, ...]:
    """Plans that are solutions of their discrete problem, but do not survive the replay; a sentence each."""
    return tuple(f"{run.scene.name} x {run.pipeline}: {run.stages[-1].why}" for run in runs if _is_finding(run))


def _is_finding(run: RunRecord) -> bool:
    return (
        run.must_hold and run.outcome == "solved" and bool(run.stages) and not run.stages[-1].paper and _is_of_the_time_step(run.stages[-1])
    )


def _is_of_the_time_step(stage: StageRecord) -> bool:
    """Whether a plan violates by nothing but the replay with feedback.

    Its residuals, its contact forces and the rollout of its inputs through its own time step with the true contact law, by code that the method
    does not share, are all below their limits, so that its method kept its word. That the open loop is not judged means that an error of one
    step grows too much along this motion; where it does not, the continuous motion of a solution must stay near it, and one that leaves it fails.
    """
    if stage.verdict != "violates" or stage.replay is None or stage.replay.judged != "tracked":
        return False
    followed = {figure.name for figure in stage.figures if figure.name.startswith("tracked_") or figure.name == "feedback_effort"}
    limited = [figure for figure in stage.figures if figure.limit is not None]
    # a figure that could not be measured, a rollout too large to be a number say, is not below its limit
    kept = all(figure.ok is True for figure in limited if figure.name not in followed)
    return kept and any(figure.ok is False for figure in limited if figure.name in followed)


def fails(record: RunRecord | ExaminationRecord) -> bool:
    """Whether a campaign fails because of this cell alone."""
    from reports.examination_record import ExaminationRecord

    return not record.passed if isinstance(record, ExaminationRecord) else bool(_cell_failure(record))


def failed_keys(records: Iterable[RunRecord | ExaminationRecord]) -> frozenset[str]:
    """Keys of the cells because of which a campaign of these records fails; of a scene on which nothing holds, all by direct methods."""
    from reports.examination_record import divided

    runs, examinations = divided(records)
    failed = {record.key for record in (*runs, *examinations) if fails(record)}
    for scene in dict.fromkeys(run.scene.name for run in runs):
        of_scene = [run for run in runs if run.scene.name == scene]
        if _scene_failure(scene, of_scene):
            failed |= {run.key for run in of_scene if run.must_hold and run.outcome != "refused"}
    return frozenset(failed)


def _examined(record: ExaminationRecord) -> str:
    ended = "failed" if record.outcome == "answered" else record.outcome.replace("_", " ")
    return f"{record.title}: {ended} - {record.found or record.message or 'the record gives no reason.'}"


def _cell_failure(run: RunRecord) -> str:
    name = f"{run.scene.name} x {run.pipeline}"
    if run.outcome in {"crashed", "failed"}:
        return f"{name}: {run.outcome} - {run.message}"
    if not run.must_hold or run.verdict == "holds" or not run.stages:
        return ""
    last = run.stages[-1]
    if (run.outcome != "solved" and not last.paper) or _is_finding(run):
        return ""
    if run.verdict == "no plan":
        return f"{name}: no plan ({run.outcome}) - {run.message or last.advice}"
    return f"{name}: {run.verdict} - {last.why}"


def _scene_failure(scene: str, runs: Sequence[RunRecord]) -> list[str]:
    direct = [run for run in runs if run.must_hold and run.outcome != "refused"]
    if not direct or any(run.verdict == "holds" for run in runs):
        return []
    endings = "; ".join(f"{run.pipeline} {run.outcome.replace('_', ' ')}, {run.verdict}" for run in direct)
    return [f"{scene}: no cell holds ({endings})"]
