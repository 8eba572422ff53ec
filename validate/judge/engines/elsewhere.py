"""Verdicts of other simulators on one plan.

    rows = elsewhere(judgement, ("fmu_everyday", "mujoco"))
    rows[1].verdict, rows[1].distance

Each engine steps the scene at two steps or tolerances, with the feedback of our replay if the
score requires feedback. The finer motion is scored; half the difference is its error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from models.codegen.kernel import load_kernel
from models.errors import SceneError
from models.scene import Limit, Scene
from validate.judge.engines.simulator import (
    LIMITS,
    REFERENCE,
    Came,
    Drive,
    EngineAnswer,
    SimulatedMotion,
    describe_engine,
    run_engine,
)
from validate.judge.judgement import Judgement
from validate.judge.replay.error_estimate import by_entry, difference
from validate.judge.replay.result import Replay, ReplayError, ReplayOutcome
from validate.judge.replay.tracking import TrackingError, design_feedback, nominals
from validate.judge.replay.wiring import Feedback, measure_effort
from validate.judge.score import Score, score, wants_feedback
from validate.processes.isolated import Limits

# Rows of an engine's motion per step of the plan.
ROWS = 4
# Engine steps per step of the plan, the coarser motion first.
PARTS = (16, 64)
_OF_THE_JUDGE = (
    "of the judge's own health; what an engine loses or gains is what its motion is judged by"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineVerdict:
    """The result of one engine; score and agrees (with our verdict) are None without a motion.

    step: [s] or tolerance. distance: largest distance from our motion at the plan's nodes, in
    nominals [-], infinite if diverged.
    """

    engine: str
    came: Came
    score: Score | None = None
    agrees: bool | None = None
    step: float | None = None
    distance: float | None = None
    why: str = ""

    @property
    def verdict(self) -> str:
        """Return the verdict, or the engine's status without a score."""
        return self.came.value if self.score is None else self.score.verdict.value

    def as_json(self) -> dict[str, Any]:
        """Return the row as JSON data; an infinite distance is null."""
        finite = self.distance is not None and math.isfinite(self.distance)
        return {
            "engine": self.engine,
            "verdict": self.verdict,
            "agrees": self.agrees,
            "step": self.step,
            "distance": self.distance if finite else None,
            "why": self.why,
        }


def elsewhere(
    judgement: Judgement,
    engines: Sequence[str],
    *,
    limits: Limits = LIMITS,
    jobs: int = 1,
    tell: Callable[[str], None] = lambda text: None,
) -> list[EngineVerdict]:
    """Return one row per engine.

    Raises SceneError without a scene or a finished replay, UnknownNameError, MachineError.
    """
    judged = _Judged(judgement, limits)

    def row(engine: str) -> EngineVerdict:
        verdict = judged.row(engine)
        tell(f"{engine}: {verdict.verdict}")
        return verdict

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        return list(pool.map(row, engines))


class _Judged:
    """Our judgement of the plan, and the inputs shared by all engines."""

    def __init__(self, judgement: Judgement, limits: Limits) -> None:
        scene = judgement.scene
        if (
            not isinstance(scene, Scene)
            or judgement.plan is None
            or judgement.replay is None
            or not judgement.replay.ok
        ):
            raise SceneError(
                "engines: they need a scene and a plan whose own replay finished. Replay this plan on a scene first."
            )
        self.ours, self.plan, self.limits = judgement, judgement.plan, limits
        waived = tuple(
            Limit(metric=name, value=None, reason=_OF_THE_JUDGE)
            for name in ("energy_residual_relative", "answer_error")
        )
        own = tuple(
            limit for limit in scene.limits if limit.metric not in {item.metric for item in waived}
        )
        self.scene, self.kernel = (
            replace(scene, limits=(*own, *waived)),
            load_kernel(scene.continuous()),
        )
        self.replay, self.nominal = judgement.replay, nominals(scene)[: scene.nq]
        self.feedback: Feedback | None = None
        if self.plan.has_states and scene.nu:
            with suppress(TrackingError):
                self.feedback = design_feedback(load_kernel(scene), scene, self.plan)

    def row(self, engine: str) -> EngineVerdict:
        about = describe_engine(engine)
        if engine == REFERENCE:
            return EngineVerdict(
                engine=engine,
                came=Came.DONE,
                score=self.ours.score,
                agrees=True,
                step=about.tolerances[-1],
                distance=0.0,
                why=self.ours.score.why,
            )
        tolerances = about.tolerances[-len(PARTS) :] or (1.0,) * len(PARTS)
        base = Drive(
            scene=self.scene.continuous(),
            plan=self.plan,
            start=np.array(self.scene.task.start, dtype=float),
            rows=ROWS,
        )
        drives = [
            replace(base, parts=parts, tolerance=tolerance)
            for parts, tolerance in zip(PARTS, tolerances, strict=True)
        ]
        answer, result = self._scored(engine, drives)
        if result is None:
            return EngineVerdict(engine=engine, came=answer.came, why=answer.why.rstrip("."))
        return EngineVerdict(
            engine=engine,
            came=Came.DONE,
            score=result,
            agrees=result.verdict is self.ours.verdict,
            step=drives[-1].tolerance if about.adaptive else drives[-1].step,
            distance=self._distance(answer.motions[-1].q),
            why=result.why,
        )

    def _scored(self, engine: str, drives: Sequence[Drive]) -> tuple[EngineAnswer, Score | None]:
        """Return the motions and the score of the last one, tracked if it wants feedback."""
        answer = run_engine(engine, drives, limits=self.limits)
        if answer.came is not Came.DONE:
            return answer, None
        opened = self._replayed(drives, answer.motions)
        result = score(self.scene, self.plan, opened)
        if self.feedback is None or not wants_feedback(result.metrics):
            return answer, result
        with_feedback = [replace(drive, feedback=self.feedback) for drive in drives]
        followed = run_engine(engine, with_feedback, limits=self.limits)
        if followed.came is not Came.DONE:
            return followed, None
        tracked = self._replayed(with_feedback, followed.motions)
        return answer, score(self.scene, self.plan, replace(opened, tracked=tracked))

    def _replayed(self, drives: Sequence[Drive], motions: Sequence[SimulatedMotion]) -> Replay:
        """Return the last motion as a replay of the scene.

        A first-order engine errs by a third of the difference of two steps 4:1; half is reported.
        """
        replays = [
            self._replay(drive, motion) for drive, motion in zip(drives, motions, strict=True)
        ]
        coarse, fine = (item.rows(item.knots) if item.ok else None for item in replays)
        error = by_entry(lambda value: 0.5 * value, difference(coarse, fine))
        return replace(replays[-1], error=ReplayError(estimate=error))

    def _replay(self, drive: Drive, motion: SimulatedMotion) -> Replay:
        plan, count = (
            self.plan,
            int(np.isfinite(np.hstack([motion.q, motion.v])).all(axis=1).argmin()) or len(motion.q),
        )
        rows = (len(motion.q) - 1) // plan.steps
        t = np.append(
            np.concatenate([np.linspace(a, b, rows, endpoint=False) for a, b in pairwise(plan.t)]),
            plan.t[-1],
        )[:count]
        q, v = motion.q[:count], motion.v[:count]
        whole, nothing = count == len(motion.q), np.zeros(count)
        kinetic, potential = self.kernel.energy(q, v)
        gap = -self.kernel.penetration(q)
        result = replace(
            self.replay, outcome=ReplayOutcome.OK if whole else ReplayOutcome.DIVERGED, message="",
            method="everyday", t=t, q=q, v=v,
            lam=self.kernel.contact_force(q, v=v), gap=gap,
            friction=np.zeros((count, self.scene.nf)), knots=np.arange(0, count, rows),
            kinetic_energy=kinetic, potential_energy=potential, contact_energy=nothing,
            input_work=None, dissipated_work=None, contact_impulse=None,
            events=(), tracked=None, feedback=None, applied=None, effort=None,
        )  # fmt: skip
        if drive.feedback is None or motion.applied is None:
            return result
        applied = motion.applied[: len(result.knots) - 1]
        return replace(
            result,
            feedback=drive.feedback,
            applied=applied,
            effort=measure_effort(plan, applied, drive.feedback),
        )

    def _distance(self, q: np.ndarray) -> float:
        """Return the largest distance of q (rows, nq) [m, rad] from our motion, in nominals [-]."""
        apart = q[:: (len(q) - 1) // self.plan.steps] - self.replay.q[self.replay.knots]
        return float(np.nan_to_num(np.abs(apart) / self.nominal, nan=np.inf).max())
