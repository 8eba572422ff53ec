"""Rule of failure of a campaign, as text and as functions of its records.

failures(runs, checks)  # sentences; none: exit code 0
findings(runs)          # plans that fail only by their grid
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from models.results.check import CheckRecord, divided
from models.results.run import RunRecord, StageRecord
from models.results.verdict import HOLD

# Causes of failure, each completing "A campaign fails if".
RULE = (
    "a run crashed, or failed in a way that its method does not explain, whatever the method",
    "a direct method reports success, and its plan does not hold - or holds only with feedback on a scene that does not say, with a reason, that it is unstable",
    "a direct method's plan of a row of the paper's Table I does not hold",
    "direct methods ran on a scene, and no run of that scene holds, with feedback or without",
    "on a scene without inputs the replay misses a closed form, or fails its own checks",
    "a check (of one of our own FMUs, a stress case) finds a fault, or ends without an answer",
)
RESULTS = (
    "A method that says itself that it stopped at a limit, stalled, diverged, found no plan or does not apply to the scene has given a result, "
    "which fails nothing.",
    "A relaxed (indirect) method is expected to violate contact physics: the report shows by how much.",
    "A plan that fails by its time step alone - it is a plan of the task, says that it reaches the goal, has physical forces and solves its own discrete "
    "equations, and what it misses by its inputs alone shrinks as its grid is refined - is a finding about the grid: it is listed, but fails nothing, "
    "whether feedback lets it hold or not.",
    "A scene without inputs has nothing to plan: its free motion is replayed and held against closed forms.",
)


# Smallest order at which an error counts as shrinking; fine grids of order one show 0.8 to 1.2.
_SHRINKS = 0.5


def failures(
    runs: Sequence[RunRecord], checks: Sequence[CheckRecord] = (), among: Sequence[RunRecord] = ()
) -> tuple[str, ...]:
    """Return a sentence per failing run or scene; among: all runs of the folder.

    Any run of `among` may solve a scene.
    """
    sentences = [sentence for run in runs if (sentence := _run_failure(run))]
    for scene in dict.fromkeys(run.scene.name for run in runs):
        sentences += _scene_failure(
            scene, [run for run in (among or runs) if run.scene.name == scene]
        )
    sentences += [_checked(record) for record in checks if not record.passed]
    return tuple(sentences)


def findings(runs: Iterable[RunRecord]) -> tuple[str, ...]:
    """Return a sentence per plan that solves its discrete problem, but fails the replay."""
    return tuple(
        f"{run.scene.name} x {run.pipeline}: {run.stages[-1].why}"
        for run in runs
        if _is_finding(run)
    )


def _is_finding(run: RunRecord) -> bool:
    claims = run.must_hold and run.outcome == "solved" and run.last is not None
    return (
        claims
        and not _is_as_it_must_be(run)
        and not run.stages[-1].paper
        and _is_of_the_time_step(run.stages[-1])
    )


def _is_of_the_time_step(stage: StageRecord) -> bool:
    """Return whether only the grid fails: 1 to 3 and 6 pass, 4 or 5 fails, refinement helps."""
    answers = {question.number: answer for question, answer in stage.questions}
    if not stage.questions or any(
        answers.get(number) not in ("yes", "not asked") for number in (1, 2, 3, 6)
    ):
        return False
    order = stage.metric("grid_order")
    fails_alone = stage.verdict == "holds with feedback" or "no" in (answers.get(4), answers.get(5))
    return fails_alone and order is not None and order.value is not None and order.value >= _SHRINKS


def fails(record: RunRecord | CheckRecord) -> bool:
    """Return whether this record alone makes a campaign fail."""
    return not record.passed if isinstance(record, CheckRecord) else bool(_run_failure(record))


def failed_keys(records: Iterable[RunRecord | CheckRecord]) -> frozenset[str]:
    """Return the keys of failing runs; on a scene where nothing holds, all by direct methods."""
    runs, checks = divided(records)
    failed = {record.key for record in (*runs, *checks) if fails(record)}
    for scene in dict.fromkeys(run.scene.name for run in runs):
        of_scene = [run for run in runs if run.scene.name == scene]
        if _scene_failure(scene, of_scene):
            failed |= {run.key for run in of_scene if run.must_hold and run.outcome != "refused"}
    return frozenset(failed)


def _checked(record: CheckRecord) -> str:
    ended = "failed" if record.outcome == "answered" else record.outcome.replace("_", " ")
    return f"{record.title}: {ended} - {record.found or record.message or 'the record gives no reason.'}"


def _run_failure(run: RunRecord) -> str:
    name = f"{run.scene.name} x {run.pipeline}"
    if run.outcome in {"crashed", "failed"}:
        return f"{name}: {run.outcome} - {run.message}"
    if not run.must_hold or run.outcome == "refused" or not run.stages or _is_as_it_must_be(run):
        return ""
    last = run.stages[-1]
    if (run.outcome != "solved" and not last.paper) or _is_finding(run):
        return ""
    if run.verdict == "no plan":
        return f"{name}: no plan ({run.outcome}) - {run.message or last.advice}"
    return f"{name}: {run.verdict} - {last.why}"


def _is_as_it_must_be(run: RunRecord) -> bool:
    """Return whether a direct method's plan holds as the scene requires."""
    if run.verdict == "holds with feedback":
        return bool(run.scene.unstable)
    return run.verdict in ("holds", "consistent", "not applicable")


def _scene_failure(scene: str, runs: Sequence[RunRecord]) -> list[str]:
    direct = [run for run in runs if run.must_hold and run.outcome != "refused"]
    if not direct or any(run.verdict in (*HOLD, "consistent") for run in runs):
        return []
    endings = "; ".join(
        f"{run.pipeline} {run.outcome.replace('_', ' ')}, {run.verdict}" for run in direct
    )
    return [f"{scene}: no run holds ({endings})"]
