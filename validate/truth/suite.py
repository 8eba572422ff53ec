"""The truth suite: every problem put to every engine at four steps, and what came of it in numbers and one sentence.

    found = measure(("fmu", "mujoco"), jobs=2, tell=print)
    found[0].problem.name, found[0].engine, found[0].levels[-1].error, found[0].order, found[0].sentence

Why an engine is wrong is measured: by the slope of its error over its step, by four times the give of its friction, by how many radians of the contact a
step is. Nothing but the CPU time differs between two runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from models.dynamics import derive
from models.scene import Scene
from validate.judge.simulator import Came, Drive, EngineAnswer, SimulatedMotion, Simulator, describe_engine, finer, run_engine
from validate.truth.problems import TruthProblem, problems

# How much softer an engine's own regularisation is made to see what it does.
SOFTER = 4.0
# The reference must come this near to every answer [-]: what its tolerance leaves after 1000 bounces is a hundredth of it.
REFERENCE, NEAR = "fmu", 1e-7
# Errors below this share are rounding, and have no order.
_ROUNDING = 1e-11
# A step so many times as short as the finest decides whether an error that did not fall falls yet.
_MUCH = 32
_LAW = "its law of contact"
# What is called right without more words.
_RIGHT = 1e-8


@dataclass(frozen=True, kw_only=True)
class Level:
    """One of the four motions of an engine: step [s] or tolerance, error and energy error as shares [-] (NaN: it diverged), microseconds a step, CPU seconds [s]."""

    step: float | None
    tolerance: float | None
    error: float
    energy: float
    microseconds: float | None
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineResult:
    """What an engine made of a problem. worst: the quantity that decides its error; order: of the error in the step, None where there is none to tell."""

    problem: TruthProblem
    engine: str
    came: Came
    sentence: str
    levels: tuple[Level, ...] = ()
    worst: str = ""
    order: float | None = None

    @property
    def error(self) -> float:
        """At the finest level [-]; NaN where there is none."""
        return self.levels[-1].error if self.levels else math.nan


def measure(engines: Sequence[str], *, jobs: int = 1, tell: Callable[[str], None] = lambda text: None) -> list[EngineResult]:
    """All problems by these engines, each in a child of its own, so many at a time.

    Raises UnknownNameError for an engine that there is not, MachineError without a compiler or room.
    """
    asked = [(problem, engine) for problem in problems() for engine in engines]
    ends = {id(problem): problem.end() for problem in dict.fromkeys(problem for problem, _ in asked)}

    def one(item: tuple[TruthProblem, str]) -> EngineResult:
        problem, engine = item
        asked, end = drives(problem, describe_engine(engine)), ends[id(problem)]
        row = judged(problem, engine, run_engine(engine, asked), end)
        if row.sentence.startswith(_LAW):
            row = _decided(row, run_engine(engine, [finer(asked[3], _MUCH)]), end)
        tell(f"{problem.phenomenon}, {problem.name}: {engine}: {row.sentence}")
        return row

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        return list(pool.map(one, asked))


def drives(problem: TruthProblem, about: Simulator) -> list[Drive]:
    """Four levels, and where the engine softens a friction the finest once more, softer."""
    start = np.array(problem.scene.task.start, dtype=float)
    common = {"scene": problem.scene, "plan": problem.plan, "start": start}
    tolerances = about.tolerances or (1.0,) * len(problem.parts)
    found = [Drive(**common, parts=parts, tolerance=tolerance) for parts, tolerance in zip(problem.parts, tolerances, strict=True)]
    if about.softens and problem.scene.nf:
        found.append(replace(found[-1], soft=SOFTER))
    return found


def judged(problem: TruthProblem, engine: str, answer: EngineAnswer, end: np.ndarray) -> EngineResult:
    """The row of an answer.

    Parameters
    ----------
    problem, engine
        What was asked, and whom.
    answer
        To `drives` of them.
    end
        (2 nq,) of `problem.end()` [m, m/s].

    Returns
    -------
    EngineResult
        With its sentence.

    Raises
    ------
    UnknownNameError
        For an engine that there is not.
    """
    if answer.came is not Came.DONE:
        return EngineResult(problem=problem, engine=engine, came=answer.came, sentence=answer.why.rstrip("."))
    about, energy = describe_engine(engine), _energy_of(problem.scene)
    told = [_errors(problem, motion, end, energy) for motion in answer.motions]
    levels = []
    for place, motion in enumerate(answer.motions[: len(problem.parts)]):
        levels.append(
            Level(
                step=None if about.adaptive else problem.duration / problem.nodes / problem.parts[place],
                tolerance=about.tolerances[place] if about.adaptive else None,
                error=_worst(told[place], problem)[0],
                energy=told[place].get("energy", math.nan),
                microseconds=1e6 * motion.seconds / motion.steps if motion.steps else None,
                seconds=motion.seconds,
            )
        )
    last = told[len(levels) - 1]
    order = None if about.adaptive else observed_order([level.error for level in levels])
    softer = _worst(told[-1], problem)[0] / levels[-1].error if len(told) > len(levels) and levels[-1].error > 0.0 else 1.0
    sentence = _why([level.error for level in levels], about.adaptive, order, softer, _radians(problem, levels[-1].step))
    return EngineResult(
        problem=problem,
        engine=engine,
        came=Came.DONE,
        sentence=sentence,
        levels=tuple(levels),
        worst=_worst(last, problem)[1],
        order=order,
    )


def _decided(row: EngineResult, answer: EngineAnswer, end: np.ndarray) -> EngineResult:
    """A row whose error does not fall over four steps, after a motion at a step much shorter: it may fall yet."""
    if answer.came is not Came.DONE:
        return row
    error = _worst(_errors(row.problem, answer.motions[0], end, _energy_of(row.problem.scene)), row.problem)[0]
    beside = f"{error:.1g} at a step {_MUCH} times as short"
    if error < row.error / 4.0:
        words = f"the step's error, uneven: {row.error:.1g}, and {beside}"
    elif error > 2.0 * row.error:
        words = f"not the step's error: {row.error:.1g}, and it grows, to {beside}"
    else:
        words = f"{row.sentence} ({beside})"
    return replace(row, sentence=words)


def observed_order(errors: Sequence[float]) -> float | None:
    """Slope of log error over log step, each step half the one before; None where fewer than two errors are more than rounding."""
    halvings = [place for place, error in enumerate(errors) if math.isfinite(error) and error > _ROUNDING]
    return None if len(halvings) < 2 else -float(np.polyfit(halvings, [math.log2(errors[place]) for place in halvings], 1)[0])


def _errors(
    problem: TruthProblem, motion: SimulatedMotion, end: np.ndarray, energy: Callable[[np.ndarray, np.ndarray], float]
) -> dict[str, float]:
    """By quantity, as shares, the energy beside them."""
    if not motion.finite:
        return {"the motion": math.nan}
    start = np.split(np.array(problem.scene.task.start, dtype=float), 2)
    true = energy(*start) if problem.energy_kept else energy(*np.split(end, 2)) if np.isfinite(end).all() else math.nan
    share = abs(energy(motion.q[-1], motion.v[-1]) - true) / max(abs(energy(*start)), abs(true))
    found = problem.errors(problem.plan.t, motion.q, motion.v, end)
    return found | ({"energy": share} if math.isfinite(share) else {})


def _worst(told: dict[str, float], problem: TruthProblem) -> tuple[float, str]:
    """The largest error and its quantity; the energy, of which there may be next to none, decides only where it is kept."""
    return max((error, name) for name, error in told.items() if name != "energy" or problem.energy_kept)


def _energy_of(scene: Scene) -> Callable[[np.ndarray, np.ndarray], float]:
    """Kinetic, potential and contact energy [J] of positions and velocities (nq,) [m, m/s]."""
    d = derive(scene)
    plain, contact = d.function([d.kinetic_energy + d.potential_energy], d.q, d.v), d.function([d.penetration, d.stiffness], d.q)

    def energy(q: np.ndarray, v: np.ndarray) -> float:
        """Of q, v (nq,) [m, m/s]: [J]. Raises nothing."""
        depth, stiffness = np.split(contact(q).ravel(), 2)
        return float(plain(q, v).item() + (stiffness * np.maximum(depth, 0.0) ** 2).sum() / 2)

    return energy


def _radians(problem: TruthProblem, step: float | None) -> float:
    """How many radians of the stiffest contact, at the start, a step is."""
    if step is None:
        return 0.0
    d = derive(problem.scene)
    q = np.array(problem.scene.task.start[: problem.scene.nq], dtype=float)
    gap, mass, k = (d.function(part, d.q)(q) for part in (d.gap_jacobian, d.mass_matrix, d.stiffness))
    return step * math.sqrt(float((k.ravel() * np.diag(gap @ np.linalg.solve(mass, gap.T))).max()))


def _why(errors: Sequence[float], adaptive: bool, order: float | None, softer: float, radians: float) -> str:
    """One sentence on the error at the finest level, by what was measured."""
    first, last = errors[0], errors[-1]
    if not math.isfinite(last):
        return "it diverges, at the finest step too"
    if last <= _RIGHT:
        return f"right to {last:.1g}"
    if radians > 1.0 and last > 1e-3:
        return f"too long a step: the finest is {radians:.1f} radians of the contact, and the error {last:.2g}"
    if softer >= SOFTER / 2:
        return f"regularised friction: {SOFTER:g} times as soft it is {softer:.1f} times as wrong; {last:.1g} at the finest step"
    if adaptive:
        return f"{last:.1g} at its tightest tolerance, {first:.1g} at its loosest"
    if order is not None and order >= 0.7:
        return f"the step's error: it falls with order {order:.1f}, to {last:.1g}"
    if math.isfinite(first) and last < first / 4.0:
        return f"the step's error: it falls from {first:.1g} to {last:.1g}, unevenly, as contacts begin and end within steps"
    return f"{_LAW}: {last:.1g}, and an eighth of the step does not mend it"
