"""The verdict matrix: does a plan hold in other simulators, and where one says otherwise, why.

By measurement.

    # judgement: of the plan on its scene, by our reference
    rows = elsewhere(judgement, ("fmu_everyday", "mujoco"))
    rows[1].verdict, rows[1].kind, rows[1].sentence

Every engine gets the plan's inputs from its start, at three steps or tolerances, each a quarter of
the one before, and what it makes of them is scored as our own replay is, with the difference of the
last two as its error; with feedback, our law around the plan, where the score asks for that. A
disagreement is of any of the three with our verdict; its class is measured
(validate.judge.disagreement).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from models.codegen.kernel import load_kernel
from models.errors import SceneError
from models.scene import Limit, Scene
from validate.execution.isolated import Limits
from validate.judge.disagreement import REFERENCE, Otherwise, level_of, size, why
from validate.judge.judgement import Judgement
from validate.judge.replay.error_estimate import by_entry, difference
from validate.judge.replay.result import Replay, ReplayError, ReplayOutcome
from validate.judge.replay.tracking import TrackingError, design_feedback, nominals
from validate.judge.replay.wiring import Feedback, measure_effort
from validate.judge.score import Score, score, wants_feedback
from validate.judge.score.unexplained import with_velocities
from validate.judge.simulator import (
    LIMITS,
    Came,
    Drive,
    EngineAnswer,
    SimulatedMotion,
    describe_engine,
    run_engine,
)

# Rows a step of the plan at which an engine's motion is looked at, and its steps in each: a quarter
# of the one before at each level.
ROWS = 4
LEVELS = (1, 4, 16)
# From which growth of an error on a motion is called unstable.
_GROWS = 30.0
_OF_THE_JUDGE = (
    "of the judge's own health; what an engine loses or gains is what its motion is judged by"
)


@dataclass(frozen=True, kw_only=True)
class EngineLevel:
    """What was found at one step: step [s] or tolerance, the verdict, the largest distance from our motion in nominal sizes [-], infinite where it diverged."""

    step: float
    verdict: str
    distance: float


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineVerdict:
    """A row: an engine, what came of asking it, its score at the finest step (None: it did not come to one), whether it agrees with ours; kind and sentence: why not."""

    engine: str
    came: Came
    agrees: bool | None = None
    score: Score | None = None
    levels: tuple[EngineLevel, ...] = ()
    kind: Otherwise = Otherwise.NONE
    sentence: str = ""

    @property
    def verdict(self) -> str:
        """In a word, or what came of asking."""
        return self.came.value if self.score is None else self.score.verdict.value

    def as_json(self) -> dict[str, Any]:
        """As JSON holds it: what is infinite is null."""
        levels = [
            asdict(level) | {"distance": level.distance if math.isfinite(level.distance) else None}
            for level in self.levels
        ]
        told = {
            "engine": self.engine,
            "verdict": self.verdict,
            "agrees": self.agrees,
            "kind": self.kind.value,
            "sentence": self.sentence,
        }
        return told | {"why": "" if self.score is None else self.score.why, "levels": levels}


def elsewhere(
    judgement: Judgement,
    engines: Sequence[str],
    *,
    limits: Limits = LIMITS,
    jobs: int = 1,
    tell: Callable[[str], None] = lambda text: None,
) -> list[EngineVerdict]:
    """A row for each engine.

    Raises SceneError for a plan without a scene or a replay, UnknownNameError, MachineError.
    """
    matrix = _Matrix(judgement, limits)

    def row(engine: str) -> EngineVerdict:
        found = matrix.row(engine)
        tell(f"{engine}: {found.verdict}{f': {found.kind.value}' if found.kind.value else ''}")
        return found

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        return list(pool.map(row, engines))


class _Matrix:
    """What is the same for all engines."""

    def __init__(self, judgement: Judgement, limits: Limits) -> None:
        scene = judgement.scene
        if (
            not isinstance(scene, Scene)
            or judgement.plan is None
            or judgement.replay is None
            or not judgement.replay.ok
        ):
            raise SceneError(
                "engines: they step scenes, by a plan whose own replay came to its end; this is not one."
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
                self.feedback = design_feedback(
                    load_kernel(scene), scene, with_velocities(scene, self.plan, judgement.replay)
                )

    def row(self, engine: str) -> EngineVerdict:
        """Ask one engine. Raises UnknownNameError, MachineError."""
        if engine == REFERENCE:
            levels = (
                EngineLevel(
                    step=describe_engine(engine).tolerances[-1],
                    verdict=self.ours.verdict.value,
                    distance=0.0,
                ),
            )
            said = "what the others are held against"
            return EngineVerdict(
                engine=engine,
                came=Came.DONE,
                agrees=True,
                score=self.ours.score,
                levels=levels,
                sentence=said,
            )
        tolerances = describe_engine(engine).tolerances[1:] or (1.0,) * len(LEVELS)
        base = Drive(
            scene=self.scene.continuous(), plan=self.plan, start=self.plan.start, rows=ROWS
        )
        drives = [
            replace(base, parts=ROWS * parts, tolerance=tolerance)
            for parts, tolerance in zip(LEVELS, tolerances, strict=True)
        ]
        answer, scores = self._scored(engine, drives)
        if answer.came is not Came.DONE:
            return EngineVerdict(engine=engine, came=answer.came, sentence=answer.why.rstrip("."))
        apart = [self._distance(motion.q) for motion in answer.motions]
        words = [found.verdict.value for found in scores]
        levels = tuple(
            EngineLevel(step=level_of(drive, engine), verdict=word, distance=distance)
            for drive, word, distance in zip(drives, words, apart, strict=True)
        )
        agreeing = [word == self.ours.verdict.value for word in words]
        kind, sentence = Otherwise.NONE, f"{size(apart[-1])} from ours"
        if not all(agreeing):
            kind, sentence = why(
                engine, drives, apart, lambda motion: self._distance(motion.q),
                settled=agreeing[-1], unstable=lambda: self._unstable(answer.motions[-1].q),
                ask=self._ask,
            )  # fmt: skip
            sentence = f"{', '.join(words)}; from ours {sentence}"
        return EngineVerdict(
            engine=engine,
            came=Came.DONE,
            agrees=all(agreeing),
            score=scores[-1],
            levels=levels,
            kind=kind,
            sentence=sentence,
        )

    def _ask(self, engine: str, drives: Sequence[Drive]) -> EngineAnswer:
        return run_engine(engine, drives, limits=self.limits)

    def _unstable(self, q: np.ndarray) -> str:
        """That our own error growth makes a motion's distance at the end of that where it begins, in words; empty: it does not."""
        growth, plan = self.replay.growth, self.plan
        if growth is None or growth.amplification <= _GROWS:
            return ""
        begin = min(int(np.searchsorted(plan.t, growth.begin)) + 1, plan.steps)
        apart = self._distance(q, slice(begin, begin + 1))
        if apart * growth.amplification < self._distance(q) / 3.0:
            return ""
        return f"{size(apart)} at {plan.t[begin]:.2g} s, and from {growth.begin:.2g} s on an error grows {growth.amplification:.2g} times"

    def _scored(self, engine: str, drives: Sequence[Drive]) -> tuple[EngineAnswer, list[Score]]:
        """The motions of these drives, and each scored against the one before it, with feedback where the score of one asks for it; or what an engine that gives none says."""
        answer = self._ask(engine, drives)
        if answer.came is not Came.DONE:
            return answer, []
        opened = self._replays(drives, answer.motions)
        scores = [score(self.scene, self.plan, item) for item in opened]
        if self.feedback is None or not any(wants_feedback(item.metrics) for item in scores):
            return answer, scores
        asked = [replace(drive, feedback=self.feedback) for drive in drives]
        followed = self._ask(engine, asked)
        if followed.came is not Came.DONE:
            return followed, []
        tracked = self._replays(asked, followed.motions)
        return answer, [
            score(self.scene, self.plan, replace(item, tracked=other))
            for item, other in zip(opened, tracked, strict=True)
        ]

    def _replays(self, drives: Sequence[Drive], motions: Sequence[SimulatedMotion]) -> list[Replay]:
        """Motions as replays of the scene.

        Of first order, at least, each is a third as wrong as it differs from the one at four times
        its step: said is a half.
        """
        made = [self._replay(drive, motion) for drive, motion in zip(drives, motions, strict=True)]
        nodes = [item.rows(item.knots) if item.ok else None for item in made]
        apart = [difference(*pair) for pair in pairwise(nodes)]
        errors = [
            by_entry(lambda value: 2.0 * value, apart[0]),
            *(by_entry(lambda value: 0.5 * value, item) for item in apart),
        ]
        return [
            replace(item, error=ReplayError(estimate=error))
            for item, error in zip(made, errors, strict=True)
        ]

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
        found = replace(
            self.replay, outcome=ReplayOutcome.OK if whole else ReplayOutcome.DIVERGED, message="",
            method="everyday", t=t, q=q, v=v,
            lam=self.kernel.contact_force(q, v=v), gap=gap,
            friction=np.zeros((count, self.scene.nf)), knots=np.arange(0, count, rows),
            kinetic_energy=kinetic, potential_energy=potential, contact_energy=nothing,
            input_work=None, dissipated_work=None, contact_impulse=None,
            events=(), tracked=None, feedback=None, applied=None, effort=None,
        )  # fmt: skip
        if drive.feedback is None or motion.applied is None:
            return found
        applied = motion.applied[: len(found.knots) - 1]
        return replace(
            found,
            feedback=drive.feedback,
            applied=applied,
            effort=measure_effort(plan, applied, drive.feedback),
        )

    def _distance(self, q: np.ndarray, times: slice = slice(None)) -> float:
        """The largest distance of a motion (rows, nq) [m, rad] from ours at the plan's nodes, in nominal sizes [-]; infinite where it diverged."""
        apart = (
            np.abs(q[:: (len(q) - 1) // self.plan.steps] - self.replay.q[self.replay.knots])[times]
            / self.nominal
        )
        return float(np.nan_to_num(apart, nan=np.inf).max())
