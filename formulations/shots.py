"""Motions through true contact that end on the goal, found by shooting.

    near = allowed_miss(scene)
    pushes = nearest_pushes(scene, kernel, near, seed=0, count=320)  # closest first
    shot = corrected(scene, kernel, pushes[0], near)
    shot, steps = cheaper(scene, kernel, shot, near, is_over)

A shot is the rollout of its inputs, so it solves the equations of its grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from formulations.contact_modes.goal import correct_end
from formulations.contact_modes.starts import input_range
from formulations.grids import input_bounds
from models.codegen.kernel import Kernel, Rollout
from models.scene import Scene
from models.scene.goal import goal_state, miss

# Numbers of constant pieces of a push, used in turn.
_PIECES = (1, 2, 4, 8)
# Shares of the input bounds, used in turn: cheap inputs are rarely near their bounds.
_SHARES = (1.0, 0.5, 0.25, 0.125)
# Newton steps of a correction.
_CORRECTIONS = 40
# Newton steps after a step towards less cost, near the goal.
_NEAR_CORRECTIONS = 10
# Steps towards less cost.
_DESCENTS = 40
# Relative gain that ends these steps.
_GAIN = 1e-4
# Factor of a step without gain.
_SHORTER = 0.25
# Number of such reductions.
_SHORTENINGS = 5
# Goal error of a corrected motion, as a share of what is allowed. If a damped contact or
# friction begins, the end jumps with the inputs, and the goal may lie within a jump.
_ARRIVED = 0.1
# The same, for a motion that ends on the goal.
_EXACT = 1e-7
# Relative change of the inputs that represents rounding.
_ROUNDING = 1e-12
# Allowed change of the motion: a millionth of a nominal per step, as for the judge.
_DEFECT = 1e-6
# Shares of the input range by which inputs are moved off a jump.
_OFF_EDGE = (1e-6, 1e-5, 1e-4, 1e-3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """Inputs u (steps, nu) [N, N m], rollout, cost, and goal error in units of what is allowed."""

    u: np.ndarray
    rollout: Rollout
    cost: float
    missed: float

    @property
    def has_arrived(self) -> bool:
        """Return whether the motion ends close enough to the goal."""
        return self.missed <= _ARRIVED


def allowed_miss(scene: Scene) -> np.ndarray:
    """Return the allowed error of each component of the end, (2*nq,) [m, rad, m/s, rad/s].

    A component with a waived limit has its nominal. Raises nothing.
    """
    sizes = []
    for part in ("position", "velocity"):
        limit = scene.limit(f"terminal_{part}_error")
        value = None if limit is None else limit.value
        sizes += [value or item.nominal for item in scene.coordinates]
    return np.array(sizes)


def nearest_pushes(
    scene: Scene, kernel: Kernel, near: np.ndarray, seed: int, count: int
) -> list[np.ndarray]:
    """Return random inputs (steps, nu) [N, N m] with a finite motion, closest to the goal first.

    near are the allowed errors (2*nq,) [m, rad, m/s, rad/s]. Raises KernelError if the mass matrix
    is not positive definite along a motion.
    """
    random, steps = np.random.default_rng(seed), scene.task.steps
    (low, high), bounds = input_range(scene), input_bounds(scene)
    start = np.array(scene.task.start)
    pushes: list[tuple[float, int, np.ndarray]] = []
    for number in range(count):
        pieces = _PIECES[number % len(_PIECES)]
        share = _SHARES[number // len(_PIECES) % len(_SHARES)]
        levels = np.clip(share * random.uniform(low, high, (pieces, scene.nu)), *bounds)
        u = levels[np.arange(steps) * pieces // steps]
        rollout = kernel.rollout(start, u, scene.task.step)
        if not rollout.diverged:
            pushes.append((_missed(scene, rollout, near), number, u))
    return [u for *_, u in sorted(pushes, key=lambda item: item[:2])]


@np.errstate(over="ignore", invalid="ignore")
def corrected(
    scene: Scene, kernel: Kernel, u: np.ndarray, near: np.ndarray, most: int = _CORRECTIONS
) -> Shot:
    """Change inputs u (steps, nu) [N, N m] as little as possible to end on the goal.

    The shot ends at least as close as the motion of u; `most` limits the Newton steps. near are the
    allowed errors (2*nq,) [m, rad, m/s, rad/s]. Raises KernelError if the mass matrix is not
    positive definite along a motion.
    """
    rollout, u = correct_end(scene, kernel, u, scale=near, most=most)
    if rollout.diverged:
        return Shot(u=u, rollout=rollout, cost=np.inf, missed=np.inf)
    return Shot(
        u=u,
        rollout=rollout,
        cost=kernel.cost(rollout.q, rollout.v, u),
        missed=_missed(scene, rollout, near),
    )


def cheaper(
    scene: Scene, kernel: Kernel, shot: Shot, near: np.ndarray, is_over: Callable[[], bool]
) -> tuple[Shot, int]:
    """Descend in the cost along motions that end on the goal; return the last shot and the steps.

    Projected gradients with Barzilai-Borwein lengths; each step is corrected. near are the allowed
    errors (2*nq,) [m, rad, m/s, rad/s]. Raises KernelError if the mass matrix is not positive
    definite along a motion.
    """
    before: tuple[np.ndarray, np.ndarray] | None = None
    length = 0.0
    for number in range(_DESCENTS):
        if is_over():
            return shot, number
        slope = kernel.adjoint(shot.rollout, shot.u, cost_bar=1.0)[0]
        downhill = _projected(scene, kernel, shot, -slope)
        if before is None:
            # A cost quadratic in the inputs is least along u after this step.
            moved, turned = shot.u, slope
        else:
            moved, turned = shot.u - before[0], before[1] - downhill
        along = float((moved * turned).sum())
        length = float((moved * moved).sum()) / along if along > 0.0 else length
        before = shot.u, downhill
        improved = _step(scene, kernel, shot, length * downhill, near)
        if improved is None:
            return shot, number
        gained, shot = shot.cost - improved.cost, improved
        if gained <= _GAIN * abs(shot.cost):
            return shot, number + 1
    return shot, _DESCENTS


def off_the_edge(scene: Scene, kernel: Kernel, shot: Shot, near: np.ndarray) -> Shot | None:
    """Return a nearby shot whose motion does not depend on rounding, or None.

    Motions jump with the inputs where a damped contact or friction begins, and optima lie at jumps.
    near are the allowed errors (2*nq,) [m, rad, m/s, rad/s]. Raises KernelError if the mass matrix
    is not positive definite along a motion.
    """
    if is_motion(scene, kernel, shot.u, shot.rollout.q):
        return shot
    (low, high), random = input_range(scene), np.random.default_rng(0)
    for share in _OFF_EDGE:
        noise = random.uniform(-1.0, 1.0, shot.u.shape) * (high - low) / 2.0
        moved = corrected(scene, kernel, shot.u + share * noise, near)
        if moved.has_arrived and is_motion(scene, kernel, moved.u, moved.rollout.q):
            return moved
    return None


@np.errstate(over="ignore", invalid="ignore")
def is_motion(scene: Scene, kernel: Kernel, u: np.ndarray, q: np.ndarray) -> bool:
    """Return whether inputs u (steps, nu) [N, N m] give the positions q (steps + 1, nq) [m, rad].

    Changes by rounding are included. Raises KernelError if the mass matrix is not positive definite
    along a motion.
    """
    nominal = min(item.nominal for item in scene.coordinates)
    most, start = len(u) * _DEFECT * nominal, np.array(scene.task.start)
    for change in (0.0, _ROUNDING, -_ROUNDING):
        moved = kernel.rollout(start, u * (1.0 + change), scene.task.step)
        if moved.diverged or np.abs(moved.q - q).max() > most:
            return False
    return True


def _step(
    scene: Scene, kernel: Kernel, shot: Shot, step: np.ndarray, near: np.ndarray
) -> Shot | None:
    for _ in range(_SHORTENINGS if step.any() else 0):
        tried = corrected(scene, kernel, shot.u + step, near, _NEAR_CORRECTIONS)
        if tried.missed <= max(shot.missed, _EXACT) and tried.cost < shot.cost:
            return tried
        step = _SHORTER * step
    return None


def _projected(scene: Scene, kernel: Kernel, shot: Shot, direction: np.ndarray) -> np.ndarray:
    """Project a direction (steps, nu) so that it neither moves the end nor leaves the bounds."""
    aimed = np.flatnonzero(~np.isnan(goal_state(scene.task)))
    slopes = np.stack(
        [
            kernel.adjoint(shot.rollout, shot.u, end_bar=end)[0]
            for end in np.eye(2 * scene.nq)[aimed]
        ]
    )
    lower, upper = input_bounds(scene)
    free, along = np.ones(shot.u.shape, dtype=bool), direction
    for _ in range(2):
        matrix, part = (slopes * free).reshape(len(slopes), -1), (direction * free).ravel()
        weights = np.linalg.lstsq(matrix @ matrix.T, matrix @ part, rcond=1e-12)[0]
        along = (part - matrix.T @ weights).reshape(shot.u.shape)
        free &= ~(((shot.u <= lower) & (along < 0.0)) | ((shot.u >= upper) & (along > 0.0)))
    return along * free


@np.errstate(over="ignore", invalid="ignore")
def _missed(scene: Scene, rollout: Rollout, near: np.ndarray) -> float:
    end = np.concatenate([rollout.q[-1], rollout.v[-1]])
    return float(np.linalg.norm(miss(end, goal_state(scene.task)) / near))
