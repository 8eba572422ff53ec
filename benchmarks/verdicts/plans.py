"""Plans as strangers write them: columns in a CSV file, some left out, printed as coarsely as they like; and what the judge said of one.

plan = Plan(t=t, q=q, v=v, u=u, lam=lam)          # arrays; None for what the author does not say
plan.but(lam=None, digits=4).write(folder / "plan.csv", scene)
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.scene import Scene
from tests.oracles.scene_motion import Motion
from tests.oracles.scene_motion import Path as Motions

REFUSED = "refused"
SKIPPED = "skipped"
BROKEN = "no answer"
# Seconds that the judge may take for a plan; it takes some tenths.
PATIENCE = 30.0
# Pieces of words of which a sentence must have one, for each cause.
DURATION = ("duration", "lasts", "seconds long")
START = ("start",)
BOUNDS = ("bound",)
FORCES = ("force",)
MOTION = ("explain", "replay", "inputs")
GOAL = ("goal", "cost")
FRICTION = ("friction", "mu n")
DEEP = ("penetrat", "deep", "through")


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Columns of a plan. t (n,) or, of inputs alone without a final time, (n - 1,); q, v (n, nq).

    U (n - 1, nu); lam (n - 1, nc); friction (n - 1, nf).

    scheme, hold: what its first lines declare ("": nothing); u_last (nu,): the inputs of the last
        row; digits: decimals of every number but for t_digits
    those of t (None: all 17 digits); columns_of: the scene whose names stand above the columns, if
        not the one it is written for.
    """

    t: np.ndarray
    u: np.ndarray
    q: np.ndarray | None = None
    v: np.ndarray | None = None
    lam: np.ndarray | None = None
    friction: np.ndarray | None = None
    scheme: str = ""
    hold: str = ""
    u_last: np.ndarray | None = None
    digits: int | None = None
    t_digits: int | None = None
    columns_of: str = ""

    def but(self, **changes: Any) -> Plan:
        """This plan with other columns."""
        return replace(self, **changes)

    def text(self, scene: Scene) -> str:
        """The CSV."""
        scene = scene_of(self.columns_of) if self.columns_of else scene
        names = (
            [item.name for item in scene.coordinates],
            [item.velocity_name for item in scene.coordinates],
        )
        groups = [
            (names[0], self.q), (names[1], self.v), ([item.name for item in scene.inputs], self.u),
            ([item.force_name for item in scene.contacts], self.lam),
            ([item.force_name for item in scene.frictions], self.friction),
        ]  # fmt: skip
        said = [
            (header, np.asarray(values, dtype=float))
            for header, values in groups
            if header and values is not None
        ]
        lines = [
            f"# {key}: {value}"
            for key, value in (("scheme", self.scheme), ("hold", self.hold))
            if value
        ]
        lines.append(",".join(["t", *(name for header, _ in said for name in header)]))
        for row, time in enumerate(self.t):
            cells = [_number(time, self.t_digits)]
            for header, values in said:
                if row < len(values):
                    cells += [_number(value, self.digits) for value in values[row]]
                elif values is self.u and self.u_last is not None:
                    cells += [_number(value, self.digits) for value in self.u_last]
                else:
                    cells += [""] * len(header)
            lines.append(",".join(cells))
        return "\n".join(lines) + "\n"

    def write(self, path: Path, scene: Scene) -> Path:
        path.write_text(self.text(scene), encoding="utf-8")
        return path


def _number(value: float, digits: int | None) -> str:
    return repr(float(value)) if digits is None else f"{value:.{digits}f}"


class NoPlanError(Exception):
    """A plan cannot be made here; the reason."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One plan and what must be said of it.

    scene: a name or a file; plan: or a function that makes it, which may raise NoPlanError;
        expected: the words that are right; causes: pieces of words, of
    which one must stand in the sentence; never: pieces that name a cause which it is not.
    """

    name: str
    scene: str
    plan: Plan | Callable[[], Plan]
    expected: tuple[str, ...]
    causes: tuple[str, ...] = ()
    never: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Said:
    """What the judge said: a verdict of its ladder, "refused" (with the error as the reason), "skipped", or "no answer" (too late, an error, a crash).

    figures: its metrics by name; fails: how many of them are beyond their limits.
    """

    verdict: str
    why: str
    fails: int = 0
    figures: Mapping[str, float | None] = field(default_factory=dict)


def judged(scene: Scene | str, plan: Path | Any) -> Said:
    """What validate.judge.judgement says.

    A refusal is an answer, any other error is none and goes on.
    """
    from validate.judge.judgement import judge

    try:
        verdict = judge(scene, plan)
    except TouchstoneError as error:
        return Said(verdict=REFUSED, why=str(error))
    score = verdict.score
    metrics = list(score.metrics.values() if isinstance(score.metrics, Mapping) else score.metrics)
    fails = sum(item.ok is False for item in metrics)
    return Said(
        verdict=score.verdict.value,
        why=score.why,
        fails=fails,
        figures={item.name: item.value for item in metrics},
    )


def judged_in_time(scene: Scene, plan: Path, seconds: float = PATIENCE) -> Said:
    """The same in a child process, so that one plan that the judge never finishes with, or dies of, is one row of the table."""
    here, there = multiprocessing.get_context("fork").Pipe(duplex=False)

    def child() -> None:
        try:
            there.send(judged(scene, plan))
        except Exception as error:  # noqa: BLE001 - any other error of the judge is what it said of this plan
            there.send(Said(verdict=BROKEN, why=f"{type(error).__name__}: {error}"))

    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    there.close()
    try:
        said = (
            here.recv()
            if here.poll(seconds)
            else Said(verdict=BROKEN, why=f"no answer within {seconds:g} s")
        )
    except EOFError:
        said = Said(verdict=BROKEN, why="its process died")
    process.kill()
    process.join()
    return said


@cache
def scene_of(reference: str) -> Scene:
    return load_scene(reference)


@cache
def motion_of(reference: str) -> Motion:
    return Motion(scene_of(reference))


@cache
def found(reference: str, pipeline: str) -> tuple[Any, ...]:
    """The plans (models.trajectory.Trajectory) of a pipeline's stages on a scene, in order.

    A stage without a plan is left out. Seconds.
    """
    from formulations.pipelines import find_pipeline, load_method, stage_plan

    plans, warm = [], None
    for leg, eps, options in stage_plan(find_pipeline(pipeline)):
        with load_method(leg.method).open(scene_of(reference), options) as session:
            solution = session.solve(eps=eps, warm_start=warm, time_limit=120.0)
        if solution.trajectory is not None:
            warm = solution.trajectory
            plans.append(warm)
    if not plans:
        raise NoPlanError(f"{pipeline} finds no plan of {reference}")
    return tuple(plans)


def as_plan(trajectory: Any, scene: Scene) -> Plan:
    """A method's plan, as it declares itself."""
    return Plan(
        t=trajectory.t, q=trajectory.q, v=trajectory.v, u=trajectory.u,
        lam=trajectory.lam[:, : scene.nc],
        friction=trajectory.lam[:, scene.nc :] if scene.nf else None,
        scheme=trajectory.scheme.value if trajectory.scheme else "",
    )  # fmt: skip


def exact(path: Motions, t: np.ndarray, u: np.ndarray, forces: str = "mean", **more: Any) -> Plan:
    """What an author writes of a motion: its states, and forces at the "start" or "end" of each step, or their "mean"."""
    friction = getattr(path, f"friction_{forces}")
    return Plan(
        t=t, u=u, q=path.q, v=path.v, lam=getattr(path, f"lam_{forces}"),
        friction=friction if friction.shape[1] else None, **more
    )  # fmt: skip


def miss(scene: Scene, state: np.ndarray) -> tuple[float, float]:
    """Distance of a state (2 nq,) from the goal, in positions and in velocities.

    0 where nothing is asked.
    """
    errors = [
        0.0 if asked is None else float(value) - asked
        for value, asked in zip(state, scene.task.goal, strict=True)
    ]
    return math.hypot(*errors[: scene.nq]), math.hypot(*errors[scene.nq :])


def goal_limits(scene: Scene, *whose: str) -> tuple[float, float]:
    """How far a motion may end from the goal, in positions and in velocities.

    Infinite where nothing is asked. whose: "", "replay_" or both.
    """

    def smallest(part: str) -> float:
        limits = [scene.limit(f"{prefix}terminal_{part}_error") for prefix in whose or ("replay_",)]
        return min(
            (limit.value for limit in limits if limit is not None and limit.value is not None),
            default=math.inf,
        )

    return smallest("position"), smallest("velocity")


@cache
def _cost(scene: Scene):
    """Functions of one step's start and of the end."""
    q, v, u = ([getattr(item, name) for item in group] for group,
               name in ((scene.coordinates, "symbol"), (scene.coordinates, "velocity"),
                        (scene.inputs, "symbol")))  # fmt: skip
    values = scene.parameter_values
    running, final = (
        sp.sympify(item).subs(values) for item in (scene.task.running_cost, scene.task.final_cost)
    )
    return sp.lambdify([q, v, u], running, modules="math"), sp.lambdify(
        [q, v], final, modules="math"
    )


def cost(scene: Scene, path: Motions, u: np.ndarray) -> float:
    """The scene's cost of a motion under u (n - 1, nu), on any grid: a sum over steps of the task's length."""
    running, final = _cost(scene)
    weights = np.diff(path.t) / scene.task.step
    steps = zip(weights, path.q[:-1].tolist(), path.v[:-1].tolist(), u.tolist(), strict=True)
    return sum(weight * running(q, v, held) for weight, q, v, held in steps) + final(
        path.q[-1].tolist(), path.v[-1].tolist()
    )


def reaches(scene: Scene, path: Motions, u: np.ndarray) -> str:
    """Why a true motion under u is not what the scene asks for: its end, its cost, its speed, its depth. Nothing if it is."""
    if not path.ended:
        return "the motion runs away"
    ends = miss(scene, np.concatenate([path.q[-1], path.v[-1]]))
    for what, value, limit in zip(
        ("position", "velocity"), ends, goal_limits(scene, "", "replay_"), strict=True
    ):
        if value > limit:
            return f"the true {what} ends {value:.3g} from the goal, limit {limit:g}"
    limit = scene.limit("replay_cost")
    if limit is not None and limit.value is not None and cost(scene, path, u) > limit.value:
        return f"its cost is {cost(scene, path, u):.4g}, limit {limit.value:g}"
    for index, item in enumerate(scene.coordinates):
        outside = max(
            float((path.v[:-1, index] - item.velocity_upper).max()),
            float((item.velocity_lower - path.v[:-1, index]).max()),
        )
        if outside > 1e-6:
            return f"{item.velocity_name} leaves its bounds by {outside:.3g}"
    for contact, depth, most in zip(scene.contacts, path.depth, scene.depths, strict=True):
        if depth > most:
            return f"contact {contact.name} is {depth:.3g} m deep, limit {most:g} m"
    return ""
