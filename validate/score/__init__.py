"""Score: (Scene, Trajectory, Replay) -> figures, each with unit, limit and reason, and a verdict.

    score(scene, plan, replay(scene, fmu, plan)).why
    -> "the replay misses the goal by 0.27 m, limit 0.06 m: force from a distance of 0.6 N s; ..."

The judge knows no method: it sees a plan and what the plan's inputs do.
"""

from __future__ import annotations

import difflib
import math
from pathlib import Path

import numpy as np

from models.errors import SceneError, TrajectoryError
from models.trajectory import Trajectory
from validate.replay.result import Replay
from validate.replay.subject import Subject
from validate.score.closed_forms import MEASURES
from validate.score.evidence import Evidence, Unmeasured
from validate.score.result import Figure, Score, Verdict
from validate.score.table import TABLE
from validate.score.tracked import Asked, asked, judged_words
from validate.score.verdict import CONTACT, EFFORT, GRID, compare, explain, verdict_of

__all__ = ["Figure", "Score", "Verdict", "check_limits", "figure_names", "score"]


def figure_names() -> tuple[str, ...]:
    """Every figure a scene may set a limit on, in the order of the table; limits on a replay are for the one that is judged."""
    return (*(entry.name for entry in TABLE), EFFORT)


def check_limits(scene: Subject, file: Path | None = None) -> None:
    """Raise SceneError for a limit on a figure, or an answer by a measure, that does not exist. file: the scene's, which the sentence then names."""
    where = f"scene {scene.name}" if file is None else f"scene file {file}: scene {scene.name}"
    for answer in scene.answers:
        if answer.measure and answer.measure not in MEASURES:
            raise SceneError(
                f"{where}: answer {answer.quantity!r} is measured by {answer.measure!r}, but the measures are {', '.join(MEASURES)}."
            )
    for limit in scene.limits:
        if limit.figure not in figure_names():
            close = difflib.get_close_matches(limit.figure, figure_names(), n=1)
            hint = f"did you mean {close[0]}?" if close else f"the figures are {', '.join(figure_names())}."
            raise SceneError(f"{where}: there is a limit on {limit.figure!r}, which is no figure; {hint}")


def score(scene: Subject, trajectory: Trajectory | None, replay: Replay | None) -> Score:
    """All figures of a plan, and whether it holds by the scene's limits. Without a replay (or one that failed) only a violation can be found.

    Raises TrajectoryError if plan, replay and scene do not belong together, SceneError for a limit on a figure that does not exist.
    """
    check_limits(scene)
    if trajectory is None:
        none = Verdict.NO_PLAN
        return Score(figures=(), verdict=none, why="there is no plan to judge.", contact=none, grid=none)
    trajectory.check_fits(scene)  # type: ignore[arg-type] - a foreign model answers what a scene answers
    if replay is not None:
        _check_belongs(scene, trajectory, replay)
    case = Evidence(scene, trajectory, replay)
    figures = tuple(_figure(item, case) for item in asked(scene, replay))
    verdict = verdict_of(figures)
    return Score(
        figures=figures,
        verdict=verdict,
        why=judged_words(replay)
        + explain(figures, verdict, planned_impulse=float((trajectory.lam[:, : scene.nc] * case.h[:, None]).sum())),
        contact=verdict_of(figure for figure in figures if figure.name in CONTACT),
        grid=verdict_of(figure for figure in figures if figure.name in GRID),
        judged="tracked" if replay is not None and replay.judged is not replay else "open",
    )


def _check_belongs(scene: Subject, trajectory: Trajectory, replay: Replay) -> None:
    if replay.scene != scene.name:
        raise TrajectoryError(f"replay: it is of scene {replay.scene}, but the plan is judged as one of {scene.name}.")
    if replay.ok and (len(replay.knots) != len(trajectory.t) or not (replay.t[replay.knots] == trajectory.t).all()):
        raise TrajectoryError(
            f"replay: its {len(replay.knots)} nodes are not the {len(trajectory.t)} of the plan; it is the replay of another plan."
        )


def _figure(item: Asked, case: Evidence) -> Figure:
    entry, limit = item.entry, item.limit
    bound = None if limit is None else limit.value
    unit = entry.unit(case.scene)
    try:
        # The plan's own time step may lead out of every bound, past its stability limit: what comes of it is not finite, and is refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            measured = entry.measure(case)
    except Unmeasured as missing:
        return Figure(
            name=entry.name, value=None, unit=unit, meaning=entry.meaning, limit=bound, reason=str(missing), ok=None, resolved=bound is None
        )
    value, error = measured if isinstance(measured, tuple) else (measured, 0.0)
    if not math.isfinite(value):
        reason = "the figure is too large to be a number."
        return Figure(
            name=entry.name, value=None, unit=unit, meaning=entry.meaning, limit=bound, reason=reason, ok=None, resolved=bound is None
        )
    ok, resolved = (None, True) if bound is None else compare(value, error, bound)
    return Figure(
        name=entry.name, value=value, unit=unit, meaning=entry.meaning, error=error, limit=bound,
        reason="" if limit is None else limit.reason, ok=ok, resolved=resolved,
    )  # fmt: skip
